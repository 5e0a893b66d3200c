// The live curves and view of a job in training.

import assert from "node:assert/strict";
import { after, before } from "node:test";

import { loaded, picture } from "./browser.js";
import { Stand, both, chart, part, seen } from "./played.js";
import { until } from "./until.js";

let stand;

before(async () => { stand = await Stand.start(); });
after(() => stand?.stop());

/** Slows the steps, so that there is time to look. */
const PLAN = "reconstruct:1500";

/** Opens the page of a job that trains with `options`, and cancels the job afterwards. */
async function training(name, width, judge, { folder = stand.folder, options = {} } = {}) {
  const { server } = stand;
  const id = await server.submit(folder, `${name} at ${width}`, { adapter: PLAN, ...options });
  try {
    await stand.visit(name, `#/jobs/${id}`, (page) => judge(page, part(page, "Training"), id), width);
  } finally {
    // The test may have cancelled it already.
    await server.cancel(id).catch(() => {});
  }
}

/** Titles of the visible charts, in order. */
const drawn = (root) => root.locator("h3:visible").allInnerTexts();

both("the loss is drawn step by step, and again after a reload", (width) =>
  training("training", width, async (page, root) => {
    const loss = chart(root, "Loss");
    const dots = () => loss.locator("circle.seen").count();
    await seen(root, /Round 1, step [\d,]+ of 1,000: \d,000 Gaussians/);
    const first = await dots();
    await until("more of it is seen", async () => (await dots()) > first);
    const before = await dots();
    await until("nothing is being fetched", () => loaded(root.locator("figure img")));
    await page.reload();
    await seen(root, "Gaussians");
    assert.ok(await dots() >= before, "events before the page was opened are drawn, too");
    assert.equal(await loss.locator("path.line").count(), 1);
    await seen(loss, "round 1");
  }));

both("held-out views are scored beside it, and one view is shown until the job ends", (width) =>
  training("held-out", width, async (page, root, id) => {
    const psnr = chart(root, "PSNR of 3 held-out views, dB");
    const scores = () => psnr.locator("circle.score").count();
    await until("scores come in", async () => (await scores()) > 2);
    assert.deepEqual(await drawn(root), ["Loss", "Live view", "PSNR of 3 held-out views, dB", "SSIM of 3 held-out views"]);
    await seen(psnr.locator(".legend"), /round 1 \d\d\.\d\d/);
    assert.equal(await root.getByText("agreement, not quality").isVisible(), false);
    const view = root.locator("figure");
    await seen(view.locator("figcaption"), /^000 \(held out\), round 1, step [\d,]+$/);
    await until("it is there", () => loaded(view.locator("img")));
    const [source, step] = [await view.locator("img").getAttribute("src"), await view.innerText()];
    await until("a new one comes", async () => (await view.locator("img").getAttribute("src")) !== source);
    await until("of a later step", async () => (await view.innerText()) !== step);
    await root.getByText("What these numbers mean").click();
    await seen(root, "sharp ground truth");
    await picture(page, `page-held-out-${width}`);
    await stand.server.cancel(id);
    await view.waitFor({ state: "hidden" });
    assert.ok((await scores()) > 2, "the curves stay");
  }));

both("without ground truth the page says that scores measure agreement", (width) =>
  training("agreement", width, async (page, root) => {
    await seen(root, "Agreement, PSNR of 3 held-out views, dB");
    await seen(root, "agreement, not quality: both can be wrong in the same way");
    await root.getByText("What these numbers mean").click();
    await seen(root, "shaken like their photographs");
    await picture(page, `page-agreement-${width}`);
  }, { folder: stand.untrue() }));

both("without held-out views there are no scores, and a training view is shown", (width) =>
  training("nothing-held-out", width, async (page, root) => {
    await seen(root.locator("figcaption"), /^000 \(training view\), round 1, step/);
    await seen(root, "Gaussians");
    assert.deepEqual(await drawn(root), ["Loss", "Live view"]);
    await picture(page, `page-nothing-held-out-${width}`);
  }, { options: { held_out: "none" } }));
