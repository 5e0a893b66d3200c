// How a job trains, drawn while it does.

import assert from "node:assert/strict";
import { after, before } from "node:test";

import { Stand, both, part, seen } from "./played.js";
import { until } from "./until.js";

let stand;

before(async () => { stand = await Stand.start(); });
after(() => stand?.stop());

both("the loss is drawn step by step, and again after a reload", async (width) => {
  const id = await stand.job("reconstruct:1500", `trains at ${width}`);
  await stand.visit("training", `#/jobs/${id}`, async (page) => {
    const training = part(page, "Training");
    const dots = () => training.locator("circle.seen").count();
    await seen(training, /Round 1, step \d+ of 250: \d,000 Gaussians/);
    const first = await dots();
    await until("more of it is seen", async () => (await dots()) > first);
    const before = await dots();
    await page.reload();
    await seen(training, "Gaussians");
    assert.ok(await dots() >= before, "what was told before the page is drawn, too");
    assert.equal(await training.locator("path.line").count(), 1);
    await seen(training, "round 1");
  }, width);
});
