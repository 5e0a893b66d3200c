// Uploads in pieces by a third-party client: tus-js-client against the real program.

import assert from "node:assert/strict";
import { randomBytes } from "node:crypto";
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";

import * as tus from "tus-js-client";

import { Server } from "./server.js";

/** Delays between attempts, ms; together longer than the server's lock of an upload. */
const DELAYS = [50, 200, 500, 1000, 2000, 4000, 8000];

const MEBIBYTE = 1 << 20;

let server;

before(async () => {
  server = await Server.start(process.env.FLED);
});

after(() => server?.stop());

/** Uploads a file and returns the upload's id; `further` are options of the client. */
function sent(content, filename, further = {}) {
  return new Promise((resolve, reject) => {
    const upload = new tus.Upload(content, {
      endpoint: `${server.base}/v1/uploads`,
      metadata: { filename },
      retryDelays: DELAYS,
      onError: reject,
      onSuccess: () => resolve(upload.url.split("/").pop()),
      ...further,
      onProgress: (bytes) => further.onProgress?.(bytes, upload),
    });
    upload.start();
  });
}

const stored = (id) => readFileSync(join(server.folder, "data/uploads", id));

test("photographs uploaded in pieces become a capture", async () => {
  const folder = join(server.capture(), "images");
  const names = readdirSync(folder);
  const uploads = await Promise.all(names.map((name) => (
    sent(readFileSync(join(folder, name)), name, { chunkSize: 5000, uploadDataDuringCreation: true })
  )));
  const answer = await fetch(`${server.base}/v1/captures`, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ uploads, name: "in pieces" }),
  });
  const capture = await answer.json();
  assert.equal(answer.status, 201, JSON.stringify(capture));
  assert.equal(capture.accepted, names.length);
  const kept = join(server.folder, "data/captures", capture.id, "images");
  for (const name of names) {
    assert.deepEqual(readFileSync(join(kept, name)), readFileSync(join(folder, name)));
  }
});

test("an upload resumes after the server was killed in the middle of it", async () => {
  const content = randomBytes(24 * MEBIBYTE);
  let again = null;
  const offsets = [];
  const id = await sent(content, "walk.zip", {
    chunkSize: 5 * MEBIBYTE,
    onProgress: (bytes) => {
      if (bytes > 12 * MEBIBYTE) again ??= server.killed();
    },
    onAfterResponse: (request, response) => {
      if (request.getMethod() === "HEAD") offsets.push(Number(response.getHeader("Upload-Offset")));
    },
  });
  await again;
  assert.ok(stored(id).equals(content));
  assert.ok(offsets.some((offset) => offset >= 10 * MEBIBYTE), `it went on at ${offsets}`);
});

test("an upload resumes on another connection while the first one hangs", async () => {
  const content = randomBytes(4 * MEBIBYTE);
  const { host } = new URL(server.base);
  const begun = await fetch(`${server.base}/v1/uploads`, {
    method: "POST",
    headers: {
      "Tus-Resumable": "1.0.0",
      "Upload-Length": content.length,
      "Upload-Metadata": "filename d2Fsay56aXA=",
    },
  });
  const path = new URL(begun.headers.get("Location"), begun.url).pathname;
  // A body that never ends, as if the client had vanished without closing its connection.
  const gone = new AbortController();
  const body = new ReadableStream({
    start: (controller) => controller.enqueue(content.subarray(0, MEBIBYTE)),
  });
  const hung = fetch(`http://${host}${path}`, {
    method: "PATCH",
    headers: {
      "Tus-Resumable": "1.0.0",
      "Upload-Offset": "0",
      "Content-Type": "application/offset+octet-stream",
    },
    body,
    duplex: "half",
    signal: gone.signal,
  }).then((answer) => answer.status, () => null);
  const id = path.split("/").pop();
  while (stored(id).length < MEBIBYTE) await new Promise((resolve) => { setTimeout(resolve, 20); });
  await sent(content, "walk.zip", { uploadUrl: server.base + path, chunkSize: MEBIBYTE });
  gone.abort();
  assert.ok([409, null].includes(await hung));
  assert.ok(stored(id).equals(content));
});
