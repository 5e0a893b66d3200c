// The messages and actions of failed jobs and refused uploads.

import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
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

both("too few poses: the photographs stay, and the first action is to upload more", async (width) =>
  stand.visit("failed-few", `#/jobs/${await failed("few_poses")}`, async (page) => {
    await seen(state(page), "failed");
    const small = part(page, "Photographs").locator(".photographs img");
    await until("the photographs are there", async () => (await small.count()) === 8 && loaded(small));
    const all = await actions(page);
    assert.equal(all[0], "Upload more photographs");
    assert.equal(all.at(-1), "Try again");
    await page.getByRole("link", { name: "Upload more photographs" }).click();
    await part(page, "New job").waitFor();
  }, width));

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
