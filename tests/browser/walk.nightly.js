// A new user's walk through the dashboard with real jobs, including the search for poses. It is
// filmed as screenshots/walk.mp4; walk-1.png and so on show the page after each step.

import assert from "node:assert/strict";
import { existsSync, readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { Browser, drawn, loaded } from "./browser.js";
import { Film } from "./film.js";
import { again, button, chart, drop, opened, part, plays, seen, state } from "./played.js";
import { Server } from "./server.js";
import { until } from "./until.js";

/** Timeout, ms; on two idle cores the longest wait is a minute. */
const LONG = 600_000;

const FIRST = "Study at dusk";
const SECOND = "Study, without kernels";
/** A round trains for some twenty seconds, long enough to look at. */
const OPTIONS = { size: 240, steps: 600 };
const BROKEN = 12;

let server;
let browser;
let photographs;
/** The ids of both jobs. */
let first;
let second;

before(async () => {
  server = await Server.start(process.env.FLED);
  browser = await Browser.start(server.base);
  photographs = taken(server.capture("240x160", 25, "study"));
});

after(async () => {
  await browser?.stop();
  await server?.stop();
});

/** The photographs with a camera's names, one of them truncated: `[name, bytes]`. */
function taken(capture) {
  const folder = join(capture, "images");
  return readdirSync(folder).sort().map((name, i) => {
    const bytes = new Uint8Array(readFileSync(join(folder, name)));
    return [name, i === BROKEN ? bytes.slice(0, bytes.length / 2) : bytes];
  });
}

const idOf = (page) => page.url().split("/").pop();

async function dropped(page) {
  await drop(page, "main", photographs);
  await page.getByText("25 files chosen").waitFor();
  await page.getByLabel("Name", { exact: true }).fill(FIRST);
  await part(page, "New job").getByLabel("Preset").selectOption("preview");
  await page.getByText("Options", { exact: true }).click();
  for (const [name, value] of Object.entries(OPTIONS)) {
    await page.locator(`[id$="-${name}"]`).first().fill(String(value));
  }
}

async function accepted(page) {
  await button(page, "Start").click();
  await seen(page.getByRole("heading", { level: 1 }), FIRST);
  first = idOf(page);
  const root = part(page, "Photographs");
  await seen(root, "24 of 25 photographs used. Not used:");
  await seen(root.locator("li"), /^012\.png: damaged or cut short: /);
  assert.equal(await root.locator("li").count(), 1);
  await seen(state(page), "running");
}

async function posed(page, film) {
  await seen(page.locator(".now"), /poses · (\d+ of \d+ photographs and pairs matched · )?\d:\d\d so far; usually one to two minutes/);
  const root = part(page, "Scene");
  const poster = root.getByRole("button", { name: /^View cameras and points/ });
  await film.fast(() => poster.waitFor({ timeout: LONG }));
  await poster.click();
  await seen(root.getByRole("status"), /[\d,]+ sparse points, used to place the cameras\./);
  await settled(page);
  await until("points are drawn", async () => (await drawn(root.locator("canvas").first())) > 0.003);
  assert.ok((await drawn(root.locator("canvas.lines"))) > 0.002, "the cameras");
  assert.deepEqual((await server.rounds(first)).rounds, [], "there is no scene yet");
}

async function curved(page, film) {
  const root = part(page, "Training");
  const psnr = chart(root, "Agreement, PSNR of 3 held-out views, dB");
  const scores = () => psnr.locator("circle.score").count();
  await film.fast(() => until("scores come in", async () => (await scores()) > 1, LONG));
  await seen(psnr.locator(".legend"), /round 1 \d\d\.\d\d/);
  await until("one view is shown", () => loaded(root.locator("figure img")));
  const { state: name, stage } = await server.job(first);
  assert.deepEqual([name, stage], ["running", "reconstruct"]);
}

const settled = (page) => page.locator(".frame[aria-busy=false]").waitFor();

/** The picture on the scene's canvas. */
const shown = (page) => page.locator(".frame canvas").first().evaluate((one) => one.toDataURL());

async function flown(page, film) {
  const trains = (job) => job.round === 2 && job.stage === "reconstruct";
  await film.fast(() => server.when(first, "trains round 2", trains, LONG));
  await page.getByRole("slider", { name: "round" }).press("ArrowRight");
  await page.locator(".rounds", { hasText: "Round 1" }).waitFor();
  await settled(page);
  await page.getByLabel("Cameras", { exact: true }).uncheck();
  await page.getByRole("button", { name: "Next photograph" }).click();
  await settled(page);
  const pictures = new Set([await shown(page)]);
  await page.getByRole("application").focus();
  for (const key of ["KeyW", "ArrowLeft", "KeyD"]) {
    await page.keyboard.press(key, { delay: 400 });
    await settled(page);
    pictures.add(await shown(page));
  }
  assert.equal(pictures.size, 4, "each time one sees something else");
  const share = await drawn(page.locator(".frame canvas").first());
  assert.ok(share > 0.1, `a scene fills the frame, not ${share} of it`);
  const { state: name, round, stage } = await server.job(first);
  assert.deepEqual([name, round, stage], ["running", 2, "reconstruct"]);
}

async function finished(page, film) {
  await film.fast(() => server.reached(first, "succeeded", LONG));
  await seen(state(page), "succeeded");
  const metrics = part(page, "Metrics by round");
  await seen(metrics, "This capture has no ground truth");
  await until("both rounds are listed", async () => (await metrics.locator("tbody tr").count()) === 2);
  await seen(page.locator(".rounds"), "Round 1");
  await button(page, "Close the 3D view").click();
  const views = part(page, "Views");
  await views.scrollIntoViewIfNeeded();
  await until("the view is there", () => loaded(views.getByRole("slider").locator("img")));
}

async function repeated(page, film) {
  const form = await again(page, String(OPTIONS.steps));
  await form.getByLabel("Training steps", { exact: true }).fill("200");
  await form.getByText("Expert options").click();
  await form.getByLabel("Shake", { exact: true }).selectOption("off");
  await form.getByLabel("Name", { exact: true }).fill(SECOND);
  await button(form, "Run").click();
  await seen(page.getByRole("heading", { level: 1 }), SECOND);
  second = idOf(page);
  await film.fast(() => server.reached(second, "succeeded", LONG));
  await seen(state(page), "succeeded");
}

async function compared(page) {
  await button(page, "Compare with…").click();
  const dialog = page.getByRole("dialog");
  await dialog.getByRole("checkbox", { name: FIRST }).check();
  await button(dialog, "Compare").click();
  await page.getByRole("heading", { name: "Compare 2 jobs" }).waitFor();
  const rows = part(page, "Options that differ").locator("table tbody tr");
  await rows.first().waitFor();
  const texts = await rows.allInnerTexts();
  assert.deepEqual(texts.map((text) => text.trim().split(/\s+/)).sort(),
    [["Shake", "off", "late"], ["Training", "steps", "200", "600"]]);
  const slider = part(page, "The same view side by side").getByRole("slider");
  await until("both sides are there", () => loaded(slider.locator("img")));
}

async function filmed(page, film) {
  await page.getByRole("link", { name: "Jobs" }).click();
  await page.getByRole("link", { name: FIRST, exact: true }).click();
  const section = await opened(page, "Videos");
  await section.getByLabel("Length").selectOption("4");
  await section.getByLabel("Long side").selectOption("640");
  await button(section, "Create video").click();
  const player = section.locator("video");
  await film.fast(() => player.waitFor({ timeout: LONG }));
  assert.deepEqual(await plays(player), { error: undefined, wide: 640, seconds: 4 });
  const file = await fetch(await player.evaluate((one) => one.src));
  const bytes = Buffer.from(await file.arrayBuffer());
  assert.equal(bytes.subarray(4, 8).toString(), "ftyp");
  assert.ok(bytes.length > 20_000, `${bytes.length} bytes`);
}

async function deleted(page, film) {
  const folder = join(server.folder, "data", "jobs", first);
  assert.ok(existsSync(folder));
  const dialog = page.getByRole("dialog", { name: `Delete job “${FIRST}”?` });
  await button(page, "Delete").first().click();
  await seen(dialog, "The photographs are kept");
  await film.still("walk-asked");
  await button(dialog, "Cancel").click();
  await dialog.waitFor({ state: "detached" });
  assert.equal((await server.job(first)).state, "succeeded");
  await button(page, "Delete").first().click();
  await button(dialog, "Delete job").click();
  await page.getByRole("link", { name: SECOND, exact: true }).waitFor();
  assert.equal(await page.getByRole("link", { name: FIRST, exact: true }).count(), 0);
  await assert.rejects(server.job(first), /404/);
  assert.ok(!existsSync(folder), "its files are gone");
  const pair = page.locator(".pair img");
  await until("pictures of the other are there", () => loaded(pair));
}

const STEPS = [dropped, accepted, posed, curved, flown, finished, repeated, compared, filmed, deleted];

test("dropped photographs become a scene to walk through, and are deleted without a trace", (t) =>
  browser.visit("walk", "", async (page) => {
    const film = await Film.start(page, "walk");
    try {
      for (const [i, step] of STEPS.entries()) {
        const began = performance.now();
        await step(page, film);
        await film.still(`walk-${i + 1}-${step.name}`);
        t.diagnostic(`${step.name}: ${((performance.now() - began) / 1000).toFixed(1)} s`);
      }
    } finally {
      t.diagnostic(`the film has ${(await film.stop()).toFixed(0)} s`);
    }
  }));
