// The messages and actions of failed jobs and refused uploads.

import assert from "node:assert/strict";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { loaded } from "./browser.js";
import { Stand, both, button, part, provoked, seen, state } from "./played.js";
import { until } from "./until.js";

let stand;
let server;

before(async () => {
  stand = await Stand.start();
  ({ server } = stand);
});

after(() => stand?.stop());

async function failed(plan) {
  const id = await stand.job(plan, `failed by ${plan}`);
  await server.reached(id, "failed");
  return id;
}

/** The visible actions of a job's head, in order. */
const actions = (page) => page.locator("h1 ~ .push > *:visible").allInnerTexts();

both("too few poses: the photographs stay, and the first action is to add some", async (width) =>
  stand.visit("failed-few", `#/jobs/${await failed("few_poses")}`, async (page) => {
    await seen(state(page), "failed");
    const small = part(page, "Photographs").locator(".photographs img");
    await until("the photographs are there", async () => (await small.count()) === 8 && loaded(small));
    const all = await actions(page);
    assert.equal(all[0], "Add photographs");
    assert.equal(all.at(-1), "Try again");
    await page.getByRole("link", { name: "Add photographs" }).click();
    await seen(part(page, "New job"), "What you choose is added to the 8 photographs of");
  }, width));

both("too little overlap: the groups, with links between photographs that match", async (width) =>
  stand.visit("failed-apart", `#/jobs/${await failed("apart")}`, async (page) => {
    await seen(state(page), "failed");
    const map = part(page, "Photographs");
    await seen(map, "These 4 and these 2 have too little in common, and 2 photographs match no other. Take some in between.");
    const small = map.locator(".overlap img");
    await until("the photographs are there", async () => (await small.count()) === 8 && loaded(small));
    const groups = await map.locator("figure").evaluateAll((all) =>
      all.map((one) => [one.querySelectorAll("img").length, one.querySelector("figcaption").innerText]));
    assert.deepEqual(groups, [[4, "4 photographs"], [2, "2 photographs"], [2, "match no other"]]);
    // Each link ends above the middles of its two photographs.
    const [first, fourth] = await Promise.all([0, 3].map((at) => small.nth(at).boundingBox()));
    const arcs = map.locator(".overlap path");
    assert.equal(await arcs.count(), 6);
    assert.equal(await map.locator(".overlap path.weak").count(), 1);
    const frame = await map.locator(".overlap svg").boundingBox();
    const ends = await arcs.nth(2).evaluate((arc) => [0, arc.getTotalLength()].map((at) => arc.getPointAtLength(at).x));
    assert.ok(Math.abs(frame.x + ends[1] - (fourth.x + fourth.width / 2)) < 2, `${ends} ${fourth.x}`);
    assert.ok(first.x < fourth.x && frame.y + frame.height <= first.y + 1);
    await seen(map, "with 17 matches, where the strongest pair has 240");
  }, width));

test("photographs are added to those of a failed job", async () => {
  const images = join(stand.folder, "images");
  const buffer = readFileSync(join(images, readdirSync(images)[0]));
  await stand.visit("failed-added", `#/jobs/${await failed("apart")}`, async (page) => {
    await page.getByRole("link", { name: "Add photographs" }).click();
    await seen(part(page, "New job"), "What you choose is added to the 8 photographs of");
    await page.getByLabel("Choose files").setInputFiles({ name: "one-more.png", mimeType: "image/png", buffer });
    const [answer] = await Promise.all([
      page.waitForResponse((response) => response.url().endsWith("/v1/jobs") && response.request().method() === "POST"),
      button(page, "Start").click(),
    ]);
    const job = await answer.json();
    assert.equal(answer.status(), 202, JSON.stringify(job));
    const capture = await (await fetch(`${server.base}/v1/captures/${job.capture_id}`)).json();
    const names = capture.images.map(({ name }) => name);
    assert.equal(names.length, 9);
    assert.ok(names.includes("one-more.png"), names.join());
  });
});

both("another failure offers to try again first", async (width) =>
  stand.visit("failed-other", `#/jobs/${await failed("bad_word")}`, async (page) => {
    await seen(state(page), "failed");
    assert.equal((await actions(page))[0], "Try again");
  }, width));

/** The colour of a PNG at a tenth of its width. */
const painted = (page, png) => page.evaluate(async (text) => {
  // The page's policy lets no script fetch an address of data.
  const bytes = Uint8Array.from(atob(text), (one) => one.charCodeAt(0));
  const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
  context.drawImage(image, 0, 0);
  return context.getImageData(image.width / 10, image.height / 2, 1, 1).data.join();
}, png);

both("the bar of a failed job does not look like one that runs", async (width) => {
  const id = await failed("few_poses");
  await stand.visit("failed-bar", "#/captures", async (page) => {
    let now = "failed";
    await page.route(`**/v1/jobs/${id}`, async (route) => {
      const job = await (await route.fetch()).json();
      await route.fulfill({ json: { ...job, state: now, progress: 0.96, error: now === "failed" ? job.error : undefined } });
    });
    const colour = async () => {
      await page.goto(`${server.base}/?${now}#/jobs/${id}`);
      await seen(state(page), now);
      const bar = await page.getByRole("progressbar", { name: "Progress" }).screenshot({ animations: "disabled" });
      return painted(page, bar.toString("base64"));
    };
    const lost = await colour();
    now = "running";
    const runs = await colour();
    now = "cancelled";
    const stopped = await colour();
    assert.equal(new Set([lost, runs, stopped]).size, 3, `${lost}, ${runs}, ${stopped}`);
    now = "failed";
    await colour();
  }, width);
});

test("a refused upload names each file once, and its files can be discarded", () =>
  stand.visit("refused", "", async (page, faults) => {
    const path = join(server.folder, "notes.jpg");
    writeFileSync(path, "no photograph");
    await page.getByLabel("Choose files").setInputFiles(path);
    await button(page, "Start").click();
    const alert = page.locator("form > .problem");
    await seen(alert, "0 of 1 photographs can be used");
    assert.equal((await alert.innerText()).split("notes.jpg").length, 2, await alert.innerText());
    const left = page.locator(".leftover");
    await seen(left, "The server still has 1 file of an upload that it refused.");
    let allow;
    const allowed = new Promise((resolve) => { allow = resolve; });
    await page.route("**/v1/jobs", async (route) => { await allowed; await route.continue(); });
    await button(page, "Start").click();
    await until("what is being sent cannot be discarded", async () => (await left.count()) === 0);
    allow();
    await seen(left, "The server still has 1 file of an upload that it refused.");
    provoked(faults, 422);
    await page.reload();
    await seen(left, "The server still has 1 file of an upload that it refused.");
    assert.equal(await page.getByText("An interrupted upload").count(), 0);
    const deleted = page.waitForResponse((answer) => answer.request().method() === "DELETE");
    await button(left, "Discard").click();
    assert.equal((await deleted).status(), 204);
    await until("it is gone", async () => (await left.count()) === 0);
    await page.reload();
    await part(page, "New job").waitFor();
    assert.equal(await left.count(), 0);
  }));
