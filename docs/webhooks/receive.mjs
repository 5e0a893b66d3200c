// Receives fled's webhooks: `FLED_WEBHOOK_SECRET=whsec_... node receive.mjs PORT` prints each that
// is genuine. Needs only Node. Copy `genuine` into your own program.

import { createHmac, timingSafeEqual } from "node:crypto";
import { createServer } from "node:http";

/** Tolerance of the timestamp, seconds; a request outside it may be a replay. */
const TOLERANCE = 300;

/** Whether `body` was signed with the secret (`whsec_...`) according to these headers, just now. */
export function genuine(secret, headers, body) {
  const sent = headers["webhook-timestamp"] ?? "";
  if (!/^\d+$/.test(sent) || Math.abs(Date.now() / 1000 - Number(sent)) > TOLERANCE) return false;
  const key = Buffer.from(secret.replace(/^whsec_/, ""), "base64");
  const mac = createHmac("sha256", key).update(`${headers["webhook-id"]}.${sent}.`).update(body);
  const wanted = Buffer.from(`v1,${mac.digest("base64")}`);
  return (headers["webhook-signature"] ?? "").split(" ").some((signature) => {
    const shown = Buffer.from(signature);
    return shown.length === wanted.length && timingSafeEqual(shown, wanted);
  });
}

async function receive(request, response) {
  const chunks = [];
  for await (const chunk of request) chunks.push(chunk);
  const body = Buffer.concat(chunks);
  if (!genuine(process.env.FLED_WEBHOOK_SECRET, request.headers, body)) {
    response.writeHead(401).end();
    return;
  }
  // The same webhook-id may arrive twice: keep a list of them if an action must happen once.
  const event = JSON.parse(body);
  console.log(request.headers["webhook-id"], event.type, JSON.stringify(event.data));
  response.writeHead(204).end();
}

// Ignore a request that is cut off.
const server = createServer((request, response) => receive(request, response).catch(() => response.destroy()));
server.listen(Number(process.argv[2]), "127.0.0.1");
