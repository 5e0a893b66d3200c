// A waiting job that no worker can run says what to start.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Stand, part, seen } from "./played.js";

const LACK = "This server runs no jobs. Start it again with --workers 1 or more.";

let stand;

before(async () => {
  stand = await Stand.start({ FLED_FAKE_WORKERS: "0" });
});

after(() => stand?.stop());

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
