#!/usr/bin/env bash
# Chromium ignores the eleventh download that a page starts by clicks, and no other.
#
# A page with links to files (`download`, Content-Disposition: attachment), each clicked through the DevTools protocol
# once the file before it has arrived: ten arrive, the click on the eleventh sends no request and no event, and the
# twelfth and thirteenth arrive again. A test of a page with many exports waits for the eleventh until it times out,
# whichever file that is. Needs a Chromium in PATH or CHROMIUM (Debian's package `chromium`), and Node.
#
# Output seen with playwright-core 1.65.1, Chromium 156.0.8078.108 (headless) and Node 20.20.2:
#   arrived: 1 2 3 4 5 6 7 8 9 10 12 13
#   requested: 1 2 3 4 5 6 7 8 9 10 12 13
set -euo pipefail
browser=${CHROMIUM:-$(command -v chromium)}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit playwright-core@1.65.1
cat >downloads.mjs <<'NODE'
import { createServer } from "node:http";
import { chromium } from "playwright-core";

const COUNT = 13;
const requested = [];
const arrived = [];
const links = Array.from({ length: COUNT }, (_, i) => `<p><a id="a${i + 1}" href="/file${i + 1}" download>${i + 1}</a>`);

const server = createServer((request, answer) => {
  const file = /^\/file(\d+)$/.exec(request.url);
  if (file) {
    requested.push(Number(file[1]));
    const disposition = `attachment; filename="${file[1]}.bin"`;
    answer.writeHead(200, { "content-type": "application/octet-stream", "content-disposition": disposition });
    answer.end("x".repeat(100));
  } else {
    answer.writeHead(200, { "content-type": "text/html" });
    answer.end(links.join(""));
  }
});
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const browser = await chromium.launch({ executablePath: process.argv[2], args: ["--no-sandbox"] });
const page = await browser.newPage();
await page.goto(`http://127.0.0.1:${server.address().port}/`);
for (let i = 1; i <= COUNT; i++) {
  const download = page.waitForEvent("download", { timeout: 5000 }).catch(() => null);
  await page.click(`#a${i}`);
  if (await (await download)?.path()) arrived.push(i);
}
console.log(`Chromium ${browser.version()}`);
await browser.close();
server.close();
console.log(`arrived: ${arrived.join(" ")}`);
console.log(`requested: ${requested.join(" ")}`);
const expected = "1 2 3 4 5 6 7 8 9 10 12 13";
process.exit(arrived.join(" ") === expected && requested.join(" ") === expected ? 0 : 1);
NODE
node downloads.mjs "$browser"
