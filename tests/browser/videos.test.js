// Videos and exports of a finished job: made, played, downloaded, deleted after confirmation.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, test } from "node:test";

import { picture } from "./browser.js";
import { Stand, both, button, opened, plays, provoked, seen } from "./played.js";
import { until } from "./until.js";

let stand;
let server;

before(async () => {
  stand = await Stand.start();
  ({ server } = stand);
});

after(() => stand?.stop());

/** A separate job, so that no test finds another's videos. */
async function finished(name) {
  const id = await stand.job("splats", name);
  await server.reached(id, "succeeded");
  return id;
}

/** Requests a video from the API: with 5 pictures a second it is slow, with 7 it fails. */
async function ask(id, body) {
  const headers = { "Content-Type": "application/json" };
  const order = { method: "POST", headers, body: JSON.stringify({ kind: "orbit", ...body }) };
  const response = await fetch(`${server.base}/v1/jobs/${id}/videos`, order);
  assert.equal(response.status, 202);
}

both("a video is requested, made, played, downloaded and deleted", async (width) => {
  const id = await finished(`filmed ${width}`);
  await stand.visit("video", `#/jobs/${id}`, async (page) => {
    const section = await opened(page, "Videos");
    await section.getByLabel("Length").selectOption("4");
    await section.getByLabel("Long side").selectOption("640");
    // By keyboard alone.
    await section.getByLabel("Long side").focus();
    await page.keyboard.press("Tab");
    await page.keyboard.press("Enter");
    const player = section.locator("video");
    await player.waitFor();
    await seen(section, "Around the scene, 4 s, 640 × 360 px");
    assert.deepEqual(await plays(player), { error: undefined, wide: 640, seconds: 4 });
    await player.evaluate((one) => { one.pause(); one.currentTime = 2; });
    await until("it is where one wants it", async () => (await player.evaluate((one) => !one.seeking && one.readyState >= 2)));
    const [download] = await Promise.all([page.waitForEvent("download"), section.getByRole("link", { name: "Download" }).click()]);
    assert.equal(download.suggestedFilename(), "orbit-640x360.mp4");
    assert.equal(readFileSync(await download.path()).subarray(4, 8).toString(), "ftyp");
    await picture(page, `video-made-${width}`);
    await button(section, "Delete").click();
    await button(page, "Cancel").click();
    assert.equal(await player.count(), 1);
    await button(section, "Delete").click();
    await button(page, "Delete video").click();
    await player.waitFor({ state: "detached" });
  }, width);
});

both("running, waiting and failed videos say so, and one is cancelled", async (width) => {
  const id = await finished(`waiting ${width}`);
  await ask(id, { fps: 7 });
  await ask(id, { fps: 5, seconds: 60, width: 128 });
  await ask(id, { fps: 5, seconds: 2, width: 128, kind: "cameras" });
  await stand.visit("videos-waiting", `#/jobs/${id}`, async (page) => {
    const section = await opened(page, "Videos");
    // The failing one is retried between the others.
    await seen(section.locator("li"), /waiting for [12] other videos?/);
    const running = section.locator("li", { hasText: "Around the scene, 60 s" });
    await seen(running, /[1-9]\d* %/);
    await picture(page, `videos-running-${width}`);
    await button(running, "Cancel").click();
    await running.waitFor({ state: "detached" });
    await section.locator("video").waitFor();
    await seen(section, "The video could not be created: ffmpeg wrote no video: planned for video.mp4");
    assert.equal(await section.locator("li").count(), 2);
  }, width);
});

test("a server that cannot make one says what to do", async () => {
  const id = await finished("refused");
  await stand.visit("video-refused", `#/jobs/${id}`, async (page, faults) => {
    const section = await opened(page, "Videos");
    await page.route("**/videos", (route) => (route.request().method() === "POST"
      ? route.fulfill({ status: 503, contentType: "application/problem+json", json: {
        detail: "Videos are not made here: there is no ffmpeg.", hint: "Whoever runs the server installs it." } })
      : route.continue()));
    await button(section, "Create video").click();
    await seen(section.getByRole("alert"), "there is no ffmpeg.\nWhoever runs the server installs it.");
    assert.ok(await button(section, "Create video").isEnabled());
    provoked(faults, 503);
  });
});

const EXPORTS = [["restored.zip", "PK"], ["linear.zip", "PK"], ["colmap.zip", "PK"], ["transforms.json", "{"], ["cameras.inria.json", "["],
  ["scene.ply", "ply\nformat"], ["scene.compressed.ply", "ply\nformat"], ["scene.glb", "glTF"], ["scene.usda", "#usda 1.0"],
  ["scene.v3.spz", "\x1f\ufffd"], ["scene.spz", "NGSP"], ["scene.sog", "PK"],
  // The fake program writes the arguments of `fled export`; the first is the job's folder.
  ["mesh.ply", "/"], ["mesh.glb", "/"]];

both("exports for other programs are downloaded from the page", async (width) => {
  const id = await finished(`exported ${width}`);
  // Chromium ignores the eleventh download of a page (findings/chromium-eleventh-download.sh).
  for (const some of [EXPORTS.slice(0, 6), EXPORTS.slice(6)]) {
    await stand.visit("exports", `#/jobs/${id}`, async (page) => {
      const section = await opened(page, "Export");
      assert.equal(await section.locator("a[download]").count(), EXPORTS.length);
      for (const [name, begin] of some) {
        const link = section.getByRole("link", { name, exact: true });
        const [download] = await Promise.all([page.waitForEvent("download"), link.click()]);
        assert.equal(download.suggestedFilename(), name);
        const content = readFileSync(await download.path());
        assert.equal(content.subarray(0, begin.length).toString(), begin);
      }
      await seen(section.locator("li"), /about \d+\.\d kB/);
    }, width);
  }
});
