// A finished job's page: its facts and rounds, its training, and the parts of the page.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Stand, both, chart, part, provoked, seen } from "./played.js";
import { until } from "./until.js";

let stand;

before(async () => {
  stand = await Stand.start();
});

after(() => stand?.stop());

const facts = (page) => page.locator(".summary dl > div").allInnerTexts();
const words = (texts) => texts.map((text) => text.replace(/\s+/g, " "));

both("a finished job shows its time, its photographs and the delivered round, and the download", async (width) => {
  const id = await stand.finished();
  await stand.visit("summary", `#/jobs/${id}`, async (page) => {
    await page.locator(".summary").waitFor();
    const texts = words(await facts(page));
    assert.match(texts[0], /^Total time \d/);
    assert.deepEqual(texts.slice(1), ["Photographs used 8 of 9", "Delivered round 2 of 2"]);
    await seen(page.locator(".summary code"), id);
    const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("link", { name: /^Download scene, / }).click()]);
    assert.equal(download.suggestedFilename(), "scene.ply");
    assert.equal(await page.getByRole("progressbar", { name: "Progress" }).isVisible(), false, "it is done");
  }, width);
});

both("the curves of the training stay on a finished job's page", async (width) =>
  stand.visit("curves", `#/jobs/${await stand.finished()}`, async (page) => {
    const root = part(page, "Training");
    await root.waitFor();
    await root.locator("details.fold").evaluate((one) => { one.open = true; });
    for (const title of ["Loss", "PSNR of 3 held-out views, dB"]) {
      const legend = chart(root, title).locator(".legend");
      await seen(legend, /round 1 \d.*round 2 \d/);
    }
    assert.equal(await root.locator("figure").isVisible(), false, "no live view is left");
  }, width));

/** Scores of a run without ground truth: each round's own are higher, the comparable ones rise. */
function scored(round) {
  const record = (reference, brightness, psnr) => ({
    split: "held_out", image: "render", reference, brightness, views: 2, psnr_db: psnr - 1, psnr_cc_db: psnr, ssim: psnr / 40,
  });
  return [record("deblurred", "native", 33 - 3 * round), record("enhanced", "native", 31 - round), record("enhanced", "final", 25 + round)];
}

/** Opens pages of a job without ground truth. */
async function untrue(name, address, judge, width) {
  const id = await stand.untold();
  await stand.visit(name, "#/captures", async (page, faults) => {
    await page.route("**/v1/jobs/*/rounds", async (route) => {
      const report = await (await route.fetch()).json();
      for (const round of report.rounds) Object.assign(round, { records: scored(round.round), score: 26.5 + round.round });
      await route.fulfill({ json: report });
    });
    await page.goto(`${stand.server.base}/${address(id)}`);
    await judge(page, faults);
  }, width);
}

both("without ground truth rounds are compared by agreement with the photographs at one brightness", async (width) =>
  untrue("agreement-rounds", (id) => `#/jobs/${id}`, async (page) => {
    const metrics = part(page, "Metrics by round");
    await seen(metrics, "this is agreement, not quality");
    const legend = chart(metrics, "PSNR with the photographs, dB").locator(".legend");
    await seen(legend, /Round 2:.*shaken as photographed 28\.50.*rendered, held out \(2 views\) 27\.00/);
    await chart(metrics, "PSNR with the photographs, dB").locator(".plot").press("ArrowLeft");
    await seen(legend, /Round 1:.* 27\.50.* 26\.00/);
    await seen(page.locator(".judged"), "28.5 dB the scene matches the photographs closely");
  }, width));

test("jobs without ground truth are compared by the same agreement", () =>
  untrue("agreement-compared", (id) => `#/compare/${id},00000000-0000-7000-8000-000000000000`, async (page, faults) => {
    const glance = page.getByRole("table", { name: "At a glance" });
    await seen(glance, "28.50");
    await seen(part(page, "Metrics by round"), "how well each scene agrees with the photographs");
    provoked(faults, 404);
  }, "desktop"));

/** Distance of a part from the top of the window, px. */
const below = (locator) => locator.evaluate((one) => one.getBoundingClientRect().top);

both("a bar links to the parts of the page, and an address opens at one", async (width) => {
  const address = `#/jobs/${await stand.finished()}`;
  await stand.visit("parts", `${address}?part=metrics`, async (page) => {
    const bar = page.getByRole("navigation", { name: "Parts of this page" });
    const metrics = part(page, "Metrics by round");
    await until("the part is gone to", async () => Math.abs((await below(metrics)) - (width === "phone" ? 40 : 52)) < 3);
    await seen(bar.locator("[aria-current]"), "Metrics");
    for (const name of ["Scene", "Files"]) await seen(bar.getByRole("link"), name);
    const names = await bar.getByRole("link").allInnerTexts();
    assert.deepEqual(names.slice(0, 5), ["Views", "Scene", "Scores", "Metrics", "Training"]);
    await bar.getByRole("link", { name: "Log" }).focus();
    await page.keyboard.press("Enter");
    await seen(part(page, "Log"), "round 2 is delivered");
    assert.equal(new URL(page.url()).hash, `${address}?part=log`);
    assert.equal(await page.evaluate(() => document.activeElement.textContent), "Log");
  }, width);
});
