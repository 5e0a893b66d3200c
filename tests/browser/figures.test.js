// What the first look at a page costs: bytes, requests, and time until something is there to read.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Stand } from "./played.js";

/** Of a page's own files, as they come over the line, without the pictures of a job. */
const MOST_BYTES = 300_000;
/** On two busy cores; an idle machine takes a twentieth of it, ms. */
const LATEST_PAINT = 5000;

let stand;

before(async () => {
  stand = await Stand.start();
});

after(() => stand?.stop());

/** Bytes and times of a page as its browser counted them. */
const figures = (page) => page.evaluate(() => {
  const entries = performance.getEntriesByType("resource");
  const [document] = performance.getEntriesByType("navigation");
  const own = [document, ...entries.filter(({ name }) => new URL(name).pathname.startsWith("/assets/"))];
  const bytes = own.reduce((total, entry) => total + entry.encodedBodySize, 0);
  const paint = performance.getEntriesByName("first-contentful-paint")[0]?.startTime;
  return { files: own.length, bytes, paint };
});

const PAGES = {
  "the list": async () => (await stand.finished(), "#/"),
  "a finished job": async () => `#/jobs/${await stand.finished()}`,
};
const READY = {
  "the list": (page) => page.locator("table a").first().waitFor(),
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
