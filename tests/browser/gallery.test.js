// The list of jobs as cards, and on a phone as a compact list.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { loaded, overflowing } from "./browser.js";
import { Stand, both, button, seen } from "./played.js";
import { until } from "./until.js";

let stand;
let server;

before(async () => {
  stand = await Stand.start();
  ({ server } = stand);
  await server.reached(await stand.job("few_poses", "a failed job"), "failed");
  await server.reached(await stand.job("little", "one with little gain"), "succeeded");
  await stand.finished();
});

after(() => stand?.stop());

const card = (page, name) => page.locator(".scene-card", { has: page.getByRole("link", { name, exact: true }) });
const FINISHED = "a finished <b>job</b>";

both("jobs are cards with their scene, verdict and time", async (width) =>
  stand.visit("gallery", "", async (page) => {
    const one = card(page, FINISHED);
    await seen(one.locator(".judged.good"), "5.0 dB better than brightening alone: a large gain");
    await seen(one, /preview · (\d+ min )?[\d.]+ s/);
    await seen(card(page, "one with little gain").locator(".judged.little"), "0.4 dB");
    const lost = card(page, "a failed job");
    await seen(lost, "too few photographs could be placed");
    await seen(lost.locator(".state"), "failed");
    const pictures = page.locator(".gallery img");
    await until("every job has a picture", async () => (await pictures.count()) === 5 && loaded(pictures));
    assert.equal(await lost.locator("img").count(), 1, "a photograph, as there is no scene");
    assert.equal(await page.getByRole("table").count(), 0);
    await page.getByRole("checkbox", { name: `Select ${FINISHED}` }).check();
    await seen(page.getByRole("region", { name: "Selected jobs" }), "1 job selected");
    await page.getByRole("checkbox", { name: `Select ${FINISHED}` }).uncheck();
    await one.click({ position: { x: 40, y: 40 } });
    await seen(page.getByRole("heading", { level: 1 }), FINISHED);
  }, width));

/** The list of jobs, with each job that the server sends replaced by `change(job)`. */
const altered = (name, change, judge) => stand.visit(name, "#/captures", async (page) => {
  await page.route("**/v1/jobs?*", async (route) => {
    const body = await (await route.fetch()).json();
    await route.fulfill({ json: { ...body, jobs: body.jobs.map((job) => (job.name === FINISHED ? { ...job, ...change(job) } : job)) } });
  });
  await page.goto(`${server.base}/#/`);
  await judge(page, card(page, FINISHED));
});

test("a job that ends while the list is open gets its verdict, and other cards stay as they are", () => {
  let change = { state: "running", finished_at: null, best_round: null };
  return altered("gallery-ends", () => change, async (page, one) => {
    await seen(one.locator(".state"), "running");
    await until("its picture is there", async () => (await one.locator(".pair img").count()) === 2);
    const other = await card(page, "one with little gain").elementHandle();
    await other.evaluate((node) => { node.firstElementChild.isMarked = true; });
    change = {};
    await seen(one.locator(".judged.good"), "5.0 dB better than brightening alone: a large gain");
    assert.ok(await other.evaluate((node) => node.isConnected && node.firstElementChild.isMarked), "it is not redrawn");
  });
});

test("a job that waits to retry shows its error and its place in the queue", () => {
  const error = { code: "device_lost", detail: "The GPU was reset." };
  const change = { state: "queued", finished_at: null, error, queue_position: 2, no_worker: "Start `fled work`." };
  return altered("gallery-retry", () => change, async (_, one) => {
    await seen(one.locator(".bad"), "the GPU stopped responding");
    await seen(one.locator(".soft"), "position 2 in the queue, waiting to retry: Start fled work.");
  });
});

const opacity = (image) => image.evaluate((one) => Number(getComputedStyle(one).opacity));

test("hovering over a card, or its focus, shows the photograph", () =>
  stand.visit("gallery-hover", "", async (page) => {
    const render = card(page, FINISHED).locator(".pair img + img");
    await render.waitFor();
    assert.equal(await opacity(render), 1);
    await card(page, FINISHED).hover();
    await until("the render is gone", async () => (await opacity(render)) === 0);
    await page.mouse.move(0, 0);
    await until("the render is back", async () => (await opacity(render)) === 1);
    await page.getByRole("checkbox", { name: /little gain$/ }).focus();
    await page.keyboard.press("Tab");
    await page.getByRole("link", { name: "one with little gain" }).focus();
    await page.keyboard.press("Shift+Tab");
    await page.keyboard.press("Tab");
    await until("the focus does the same", async () =>
      (await opacity(card(page, "one with little gain").locator(".pair img + img"))) === 0);
  }));

test("a touch screen has a button for the photograph", () =>
  stand.visit("gallery-touch", "", async (page) => {
    const render = card(page, FINISHED).locator(".pair img + img");
    await render.waitFor();
    const peek = button(page, `Photograph of ${FINISHED}`);
    await peek.tap();
    await until("the render is gone", async () => (await opacity(render)) === 0);
    assert.equal(await peek.getAttribute("aria-pressed"), "true");
    assert.equal(new URL(page.url()).hash, "", "the job is not opened");
    await peek.tap();
    await until("the render is back", async () => (await opacity(render)) === 1);
    assert.equal(await card(page, "a failed job").locator(".peek").isVisible(), false);
  }, "phone", { hasTouch: true, isMobile: true }));

both("the browser remembers the choice of a table", async (width) =>
  stand.visit("gallery-table", "", async (page) => {
    await card(page, FINISHED).waitFor();
    await button(page, "Table").click();
    await page.getByRole("table").waitFor();
    assert.equal(await page.locator(".scene-card").count(), 0);
    await page.reload();
    await page.locator("tbody tr").first().waitFor();
    assert.equal(await button(page, "Table").getAttribute("aria-pressed"), "true");
    await button(page, "Cards").click();
    await card(page, FINISHED).waitFor();
  }, width));

test("a phone shows at least three jobs of the compact list on a screen", () =>
  stand.visit("gallery-compact", "", async (page) => {
    const { jobs: [job] } = await (await fetch(`${server.base}/v1/jobs?limit=1`)).json();
    const jobs = Array.from({ length: 6 }, (_, i) => ({ ...job, id: `${job.id.slice(0, -1)}${i}`, name: `job with a longer name ${i}` }));
    await page.route("**/v1/jobs?*", (route) => route.fulfill({ json: { jobs } }));
    await page.route("**/artifacts/cameras.json", (route) => route.fulfill({ json: [] }));
    // Cards ask for it, if they see the jobs first.
    await page.route("**/rounds", (route) => route.fulfill({ json: { rounds: [] } }));
    await button(page, "Table").click();
    const rows = page.locator("tbody tr");
    await until("they are there", async () => (await rows.count()) === 6);
    const heights = await rows.evaluateAll((all) => all.map((one) => one.getBoundingClientRect().height));
    assert.ok(Math.max(...heights) < 844 / 8, `${heights}`);
    await rows.first().evaluate((one) => one.scrollIntoView());
    const whole = await rows.evaluateAll((all) => all.filter((one) => one.getBoundingClientRect().bottom <= innerHeight).length);
    assert.ok(whole >= 3, `${whole} jobs`);
    assert.deepEqual(await overflowing(page), []);
  }, "phone"));
