// A waiting job that no worker can run says what to start.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Stand, both, part, seen } from "./played.js";

const LACK = "This server runs no jobs. Start it again with --workers 1 or more.";

let stand;

before(async () => {
  stand = await Stand.start({ FLED_FAKE_WORKERS: "0" });
});

after(() => stand?.stop());

both("the header says that there is no worker, and what to start", async (width) =>
  stand.visit("unstaffed-header", "#/api", async (page) => {
    const body = await (await fetch(`${stand.server.base}/readyz`)).json();
    const lacks = body.checks.filter((check) => check.name === "workers");
    const health = page.locator("#health");
    for (const [ready, words] of [[true, "No worker"], [false, "Not ready: workers"]]) {
      await page.route("**/readyz", (route) => route.fulfill({ json: { ready, checks: lacks } }));
      await page.reload();
      await seen(health, words);
      assert.match(await health.getAttribute("title"), /^workers: [^`]+$/);
    }
  }, width));

test("a job without a worker says so on its page, in the list and among waiting jobs", async () => {
  const id = await stand.job("ok");
  await stand.visit("unstaffed", `#/jobs/${id}`, async (page) => {
    await seen(page.locator("main"), LACK);
    await page.getByRole("link", { name: "Jobs", exact: true }).click();
    await seen(page.locator("main"), LACK);
    await page.goto(`${stand.server.base}/#/workers`);
    await seen(part(page, "Waiting"), LACK);
  });
  const { checks, ready } = await (await fetch(`${stand.server.base}/readyz`)).json();
  const workers = checks.find((check) => check.name === "workers");
  assert.equal(workers.ok, false, "the check says so");
  assert.equal(ready, checks.every((check) => check.ok || check === workers), "jobs are accepted without a worker");
});
