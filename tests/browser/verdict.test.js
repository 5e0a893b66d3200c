// The first screen of a finished job: its verdict in plain words, and the way to each view.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { LIMITS, done, found, notable, verdict } from "../../web/job/verdict.js";
import { loaded } from "./browser.js";
import { Stand, both, button, part, seen } from "./played.js";
import { until } from "./until.js";

let stand;

before(async () => {
  stand = await Stand.start();
});

after(() => stand?.stop());

async function played(plan) {
  const id = await stand.job(plan, `one with plan ${plan}`);
  await stand.server.reached(id, "succeeded");
  return id;
}

/** Opens a job's page; `change(report)` alters what the server says of its rounds. */
async function opened(name, id, judge, width, change = null) {
  await stand.visit(name, "#/captures", async (page) => {
    if (change) {
      await page.route("**/v1/jobs/*/rounds", async (route) => {
        const report = await (await route.fetch()).json();
        change(report);
        await route.fulfill({ json: report });
      });
    }
    await page.goto(`${stand.server.base}/#/jobs/${id}`);
    await page.locator(".verdict").waitFor();
    await judge(page);
  }, width);
}

const lines = async (page) =>
  (await page.locator(".verdict p").allInnerTexts()).map((text) => text.replace(/\s+/g, " "));

/** Whether an element lies in the window without scrolling. */
const onScreen = (locator) => locator.evaluate((one) => {
  const box = one.getBoundingClientRect();
  return scrollY === 0 && box.top >= 0 && box.bottom <= innerHeight;
});

both("a large gain is the first thing that a finished job says", async (width) =>
  opened("verdict-large", await played("ok"), async (page) => {
    assert.deepEqual(await lines(page), [
      "5.0 dB better than brightening alone: a large gain",
      "Found: 2 of 8 photographs are shaken, by up to 7 px; exposures differ by up to 1.2 stops; the photographs are 3.5 stops too dark.",
      "Done: Brightened by 3.5 stops; exposures evened out; the shake of 3 photographs corrected; noise reduced 2.0 times.",
      "Compared with the ground truth of this capture.",
    ]);
    assert.ok(await onScreen(page.locator(".judged")), "on the first screen");
    assert.doesNotMatch(await page.locator(".summary").innerText(), /PSNR|SSIM|held out/);
  }, width));

both("with little gain the views that are worse than their photographs are one press away", async (width) =>
  opened("verdict-little", await played("little"), async (page) => {
    const [judged, worse] = await lines(page);
    assert.equal(judged, "0.4 dB better than brightening alone: little gain");
    assert.equal(worse, "Worse than the photographs in 2 of 8 views: 002, 006");
    await page.locator(".verdict").getByRole("button", { name: "006" }).click();
    const views = part(page, "Views");
    assert.equal(await views.getByRole("combobox", { name: "View" }).inputValue(), "006");
    await seen(views.locator("h2"), "Views");
    await until("it shows that view", async () =>
      (await views.getByRole("slider").locator("img").first().getAttribute("src")).includes("/006"));
    assert.equal(await page.evaluate(() => document.activeElement.textContent), "Views");
  }, width));

both("sharp and clean photographs explain why little was gained", async (width) =>
  opened("verdict-clean", await played("little"), async (page) => {
    const [judged] = await lines(page);
    assert.equal(judged, "0.4 dB better than brightening alone: little gain; the photographs were already sharp and clean");
    assert.match((await lines(page))[2], /no photograph is shaken/i);
  }, width, (report) => {
    report.shaken_views = 0;
    for (const round of report.rounds) {
      round.noise_sigma = { enhanced: LIMITS.clean / 2, render: LIMITS.clean / 4 };
      round.kernels = 0;
    }
  }));

both("a result worse than brightening says so", async (width) =>
  opened("verdict-worse", await played("worse"), async (page) => {
    const [judged, worse] = await lines(page);
    assert.equal(judged, "0.8 dB worse than brightening alone");
    assert.match(worse, /^Worse than the photographs in 8 of 8 views: 000, 001, 002, 003, 004, …$/);
    assert.equal(await page.locator(".judged.worse").count(), 1);
    assert.match((await lines(page))[3], /^Done: .* corrected\.$/, "weak noise is no merit of a blurred scene");
  }, width));

both("without ground truth the verdict is agreement, and says that it is not quality", async (width) =>
  opened("verdict-untold", await stand.untold(), async (page) => {
    const all = await lines(page);
    assert.equal(all[0], "27.5 dB the scene matches the photographs closely");
    assert.equal(all.at(-1), "Without ground truth this measures agreement with the photographs, not quality.");
  }, width));

test("each threshold divides the verdicts", () => {
  const record = (image, psnr_cc_db) => ({ image, split: "train", brightness: "final", reference: "gt", psnr_cc_db });
  const of = (gain) => verdict({
    best_round: 1,
    rounds: [{ round: 1, views: [], noise_sigma: { enhanced: 1 }, records: [record("render", 20 + gain), record("enhanced", 20)] }],
  });
  for (const [gain, tone, words] of [
    [LIMITS.large, "good", "a large gain"],
    [LIMITS.large - 0.01, "good", "a clear gain"],
    [LIMITS.clear - 0.01, "little", "little gain"],
    [0, "little", "little gain"],
    [LIMITS.worse - 0.01, "worse", "worse than brightening alone"],
  ]) {
    assert.equal(of(gain).tone, tone, `${gain} dB`);
    assert.ok(of(gain).words.endsWith(words), of(gain).words);
  }
  const agrees = (score, ceiling) => verdict({
    best_round: 1,
    rounds: [{ round: 1, score, noise_ceiling_db: ceiling, noise_sigma: { enhanced: 1 }, records: [],
      views: [{ name: "a", fit: LIMITS.alike - 0.01 }, { name: "b", fit: LIMITS.alike }, { name: "c", fit: null }] }],
  });
  assert.deepEqual([LIMITS.close, LIMITS.fair, LIMITS.fair - 0.01].map((score) => agrees(score, 40).tone), ["good", "little", "worse"]);
  assert.equal(agrees(18, 20).tone, "good", "noise limits what can be reached");
  assert.deepEqual(agrees(30, 40).views, ["a"]);
  // A report of an earlier version: the score is an SSIM, and there are no rows by view.
  assert.equal(verdict({ best_round: 1, rounds: [{ round: 1, score: 0.7, records: [] }] }), null);
});

test("photographs are as dark as the last round finds them, and brightened by the delivered one", () => {
  const round = (number, ev, render = 0.01) => ({ round: number, anchor: { ev }, noise_sigma: { enhanced: 0.04, render }, records: [] });
  const report = { best_round: 1, registered: 8, views: 8, rounds: [round(1, 2), round(2, 3.5)] };
  assert.deepEqual(found(report), ["the photographs are 3.5 stops too dark"]);
  assert.deepEqual(done(report), ["brightened by 2.0 stops", "noise reduced 4.0 times"]);
  assert.deepEqual(done({ ...report, rounds: [round(1, 2, 0)] }), ["brightened by 2.0 stops"], "no finite ratio");
});

test("little to gain explains little agreement only", () => {
  const words = (score) => verdict({
    best_round: 1, shaken_views: 0,
    rounds: [{ round: 1, score, noise_ceiling_db: 40, noise_sigma: { enhanced: LIMITS.clean / 2 }, records: [], views: [] }],
  }).words;
  assert.match(words(LIMITS.fair), /; the photographs were already sharp and clean, so there was little to gain$/);
  for (const score of [LIMITS.close, LIMITS.fair - 1]) assert.doesNotMatch(words(score), /already/);
});

/** Ground truth of some photographs only: the others are compared with themselves, brightened. */
function mixed(report) {
  for (const view of report.rounds.at(-1).views.slice(5)) {
    Object.assign(view, { reference: "enhanced", psnr_cc_db: 90, photograph_psnr_cc_db: null });
  }
}

test("gains are not ranked among scores", () => {
  const view = (name, psnr_cc_db, photograph_psnr_cc_db) =>
    ({ name, psnr_cc_db, photograph_psnr_cc_db, reference: photograph_psnr_cc_db ? "gt" : "enhanced" });
  const of = (...views) => notable({ rounds: [{ views }] });
  const some = of(view("a", 22, 20), view("b", 30, null), view("c", 21, 20), view("d", 25, 20));
  assert.deepEqual(some, { typical: "a", best: "d", poorest: "c" });
  const none = of(view("a", 22, null), view("b", 30, null), view("c", 21, null));
  assert.deepEqual(none, { typical: "a", best: "b", poorest: "c" });
});

test("with ground truth of some photographs only those are counted, and their scores shown", async () =>
  opened("verdict-mixed", await played("little"), async (page) => {
    assert.equal((await lines(page))[1], "Worse than the photographs in 1 of 5 views: 002");
    const cells = part(page, "Scores by view").locator("tbody tr");
    await cells.first().waitFor();
    assert.equal(await cells.locator("[data-label='Gain, dB']", { hasText: /\d/ }).count(), 5);
    assert.equal(await cells.locator("[data-label='Score, dB']", { hasText: /\d/ }).count(), 5);
  }, "desktop", mixed));

both("the comparison comes before the scene, at the pictures' size, with a typical view first", async (width) =>
  opened("verdict-views", await played("ok"), async (page) => {
    const views = part(page, "Views");
    const images = views.getByRole("slider").locator("img");
    await until("both sides are there", () => loaded(images));
    const top = async (title) => (await part(page, title).boundingBox()).y;
    await part(page, "Scene").waitFor();
    assert.ok((await top("Views")) < (await top("Scene")));
    const choice = views.getByRole("combobox", { name: "View" });
    assert.equal(await choice.inputValue(), "000");
    for (const [name, view] of [["Best", "005"], ["Poorest", "002"], ["Typical", "000"]]) {
      await button(views, name).click();
      assert.equal(await choice.inputValue(), view, name);
      assert.equal(await button(views, name).getAttribute("aria-pressed"), "true");
    }
    // A wide picture is as wide as it is, or as its place.
    await images.first().evaluate(async (image) => {
      const wide = new OffscreenCanvas(1000, 500);
      wide.getContext("2d");
      const url = URL.createObjectURL(await wide.convertToBlob());
      for (const one of image.closest(".compare").querySelectorAll("img")) one.src = url;
    });
    const place = await images.first().evaluate((image) => image.closest("section").querySelector(".tools").clientWidth);
    await until("it has its own size", async () =>
      Math.round((await views.locator(".compare").boundingBox()).width) === Math.min(1000, place));
  }, width));

/** The first column of the list of views. */
const order = (page) => part(page, "Scores by view").locator("tbody tr td:first-child").allInnerTexts();

both("the list of views begins with the worst, is sorted by each column, and opens a view", async (width) =>
  opened("verdict-list", await played("little"), async (page) => {
    const root = part(page, "Scores by view");
    await root.waitFor();
    await root.locator("details").evaluate((one) => { one.open = true; });
    assert.deepEqual((await order(page)).slice(0, 2), ["002", "006"]);
    await seen(root.locator(".hint"), "Worst first. Choose a photograph");
    const sort = async (title) => {
      const choice = root.getByLabel("Sort by");
      if (width === "phone") {
        await choice.focus();
        await choice.selectOption(title);
        assert.equal(await choice.evaluate((one) => one === document.activeElement), true);
      }
      else await root.getByRole("button", { name: title }).click();
    };
    await sort("Shake, px");
    assert.deepEqual((await order(page)).slice(0, 2), ["005", "001"], "the most shaken first");
    await seen(root.locator(".hint"), /^Choose a photograph/);
    const head = root.locator("th", { hasText: "Shake" });
    assert.equal(await head.getAttribute("aria-sort"), "descending");
    const row = root.locator("tbody tr").first();
    await seen(row.locator("[data-label='Shake, px']"), "7.0");
    await seen(row.locator("[data-label='Exposure, stops']"), "+0.60");
    await seen(row.locator("[data-label=Position]"), "placed");
    if (width === "desktop") {
      await sort("Shake, px");
      assert.equal(await head.getAttribute("aria-sort"), "ascending");
      assert.equal((await order(page)).at(-1), "005");
      assert.equal(await head.getByRole("button").evaluate((one) => one === document.activeElement), true);
    }
    await root.getByRole("button", { name: "005" }).click();
    assert.equal(await part(page, "Views").getByRole("combobox", { name: "View" }).inputValue(), "005");
  }, width));

both("a photograph without a position says so in the list", async (width) =>
  opened("verdict-lost", await played("ok"), async (page) => {
    const root = part(page, "Scores by view");
    await root.waitFor();
    await root.locator("details").evaluate((one) => { one.open = true; });
    const last = root.locator("tbody tr").last();
    await seen(last, /003[\s\S]*not placed/);
    assert.equal(await last.getByRole("button").count(), 0, "it has no pictures");
    assert.match((await lines(page))[1], /^Found: 7 of 8 photographs could be placed/);
  }, width, (report) => {
    report.registered = 7;
    report.poses.verdicts[3].status = "not_found";
    const row = report.rounds.at(-1).views[3];
    for (const key of Object.keys(row)) if (key !== "name") row[key] = null;
    row.registered = false;
  }));
