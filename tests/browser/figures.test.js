// The cost of opening a page: bytes, requests, and time to the first text.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Stand } from "./played.js";

/** Limit for a page's own files as transferred, without the pictures of a job. */
const MOST_BYTES = 300_000;
/** Limit on two busy cores, ms; an idle machine takes a twentieth of it. */
const LATEST_PAINT = 5000;

/** Limit for the modules of the form and the list; the page has three other files of its own. */
const MOST_MODULES = 32;
/** Limit for the same on two busy cores, over a mobile network, ms; an idle machine: 1500. */
const LATEST_START = 5000;
/** How long nothing more is fetched, ms. */
const REST_MS = 3000;

let stand;

before(async () => {
  stand = await Stand.start();
});

after(() => stand?.stop());

/** Bytes and times of a page as measured by its browser. */
const figures = (page) => page.evaluate(() => {
  const entries = performance.getEntriesByType("resource");
  const [document] = performance.getEntriesByType("navigation");
  const own = [document, ...entries.filter(({ name }) => new URL(name).pathname.startsWith("/assets/"))];
  const bytes = own.reduce((total, entry) => total + entry.encodedBodySize, 0);
  const paint = performance.getEntriesByName("first-contentful-paint")[0]?.startTime;
  return { files: own.length, bytes, paint };
});

/** Emulates a mobile network: 150 ms to the first byte of each answer, 1.6 Mbit/s. */
async function slow(page) {
  const session = await page.context().newCDPSession(page);
  await session.send("Network.enable");
  await session.send("Network.emulateNetworkConditions",
    { offline: false, latency: 150, downloadThroughput: 200_000, uploadThroughput: 200_000 });
}

test("over a mobile network a job can soon be started, and nothing is fetched that is not shown", async (t) => {
  await stand.finished();
  const context = await stand.browser.chromium.newContext();
  try {
    const page = await context.newPage();
    await slow(page);
    const asked = [];
    page.on("request", (request) => asked.push(new URL(request.url()).pathname));
    const begun = Date.now();
    await page.goto(`${stand.server.base}/#/`);
    await page.locator("form button.main", { hasText: "Start" }).waitFor();
    await page.getByLabel("Preset").first().locator("option").first().waitFor({ state: "attached" });
    const usable = Date.now() - begun;
    await READY["the list"](page);
    const scripts = () => asked.filter((path) => path.endsWith(".js"));
    const shown = scripts().length;
    await page.waitForTimeout(REST_MS);
    t.diagnostic(`Start after ${usable} ms; ${shown} modules with the list, ${asked.length} requests in all`);
    assert.ok(shown > 20 && shown <= MOST_MODULES, `${shown} modules`);
    assert.equal(scripts().length, shown, "the modules of other pages wait until they are wanted");
    assert.ok(usable < LATEST_START, `${usable} ms`);
    await Promise.all([
      page.waitForRequest((request) => request.url().endsWith("/job/job.js")),
      page.locator(".gallery a").first().hover(),
    ]);
  } finally {
    await context.close();
  }
});

const PAGES = {
  "the list": async () => (await stand.finished(), "#/"),
  "a finished job": async () => `#/jobs/${await stand.finished()}`,
};
const READY = {
  "the list": (page) => page.locator(".gallery a").first().waitFor(),
  "a finished job": (page) => page.locator(".summary").waitFor(),
};

for (const [name, where] of Object.entries(PAGES)) {
  test(`${name} costs less than ${MOST_BYTES / 1000} kB`, async (t) => {
    const hash = await where();
    await stand.visit(`figures-${name.split(" ").pop()}`, hash, async (page) => {
      await READY[name](page);
      const { files, bytes, paint } = await figures(page);
      t.diagnostic(`${files} files, ${Math.round(bytes / 1000)} kB, to read after ${Math.round(paint)} ms`);
      assert.ok(files > 10, "the page's own files were counted");
      assert.ok(bytes < MOST_BYTES, `${bytes} bytes`);
      assert.ok(paint < LATEST_PAINT, `${paint} ms`);
    });
  });
}

test("over a mobile network no module waits for another, and a reload fetches none", async (t) => {
  await stand.finished();
  // A page whose requests a test intercepts has no cache.
  const context = await stand.browser.chromium.newContext();
  try {
    const page = await context.newPage();
    await slow(page);
    const shown = async (load) => {
      const begun = Date.now();
      await load();
      await READY["the list"](page);
      return Date.now() - begun;
    };
    const own = () => page.evaluate(() => performance.getEntriesByType("resource")
      .filter(({ name }) => new URL(name).pathname.startsWith("/assets/"))
      .map(({ name, startTime, transferSize }) => ({ name, startTime, transferSize })));
    const first = await shown(() => page.goto(`${stand.server.base}/#/`));
    const begun = (await own()).filter(({ name }) => name.endsWith(".js")).map(({ startTime }) => startTime);
    assert.ok(begun.length > 10, "the page's modules were counted");
    begun.sort((a, b) => a - b);
    const waves = begun.filter((time, i) => i === 0 || time - begun[i - 1] > 100);
    assert.equal(waves.length, 2, `those of the form at once, then those of the list at once: ${begun}`);
    const again = await shown(() => page.reload());
    t.diagnostic(`the list is there after ${first} ms, after a reload ${again} ms`);
    assert.deepEqual((await own()).filter(({ transferSize }) => transferSize > 0), [], "all are kept");
  } finally {
    await context.close();
  }
});
