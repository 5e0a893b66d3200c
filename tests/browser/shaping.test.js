// A crop and a scale drawn in the 3D view, by pointer, keys and touch, and the exports that they
// shape.

import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { notable } from "../../web/job/verdict.js";
import { poseOf, surroundingsOf, unit } from "../../web/scene/camera.js";
import { readHeader } from "../../web/scene/ply.js";
import { Browser, PHONE, overflowing, picture } from "./browser.js";
import { provoked, opened as unfolded } from "./played.js";
import { walled } from "./ply.js";
import { Server } from "./server.js";
import { until } from "./until.js";

const SIZE = { width: 1000, height: 900 };

let server;
let browser;
let id;
/** The wall in front of the camera from which the view starts, its normal, the ring's radius. */
let wall;
let camera;

before(async () => {
  server = await Server.start(process.env.FLED);
  browser = await Browser.start(server.base);
  id = await server.submit(server.capture(), "a scene");
  await server.reached(id, "succeeded");
  const output = join(server.folder, "data", "jobs", id, "output");
  const cameras = JSON.parse(readFileSync(join(output, "cameras.json"), "utf8"));
  const report = await server.rounds(id);
  const start = notable(report).best;
  camera = cameras.find(({ name }) => name === start);
  const { centre, radius } = surroundingsOf(cameras);
  const { axes } = poseOf(camera);
  const normal = unit([0, 1, 2].map((k) => axes[2][k] + 0.4 * axes[0][k]));
  wall = { centre, normal, radius, bytes: walled(centre, normal, radius) };
  for (const path of [`rounds/${report.best_round}/scene.ply`, "scene.ply"]) {
    writeFileSync(join(output, path), wall.bytes);
  }
});

after(async () => {
  await browser?.stop();
  await server?.stop();
});

const frame = (page) => page.getByRole("application");
const settled = (page) => page.locator(".frame[aria-busy=false]").waitFor();
const select = (page) => page.getByRole("combobox", { name: "Crop", exact: true });
const place = (page) => page.getByRole("button", { name: "Place", exact: true });
const said = (page, words) => page.locator(".stage .hint", { hasText: words }).waitFor();
const near = (a, b, by, what) => assert.ok(Math.abs(a - b) < by, `${what}: ${a}, not ${b}`);

/** Opens the scene on the job's page and passes it on once it is shown. */
const opened = (name, judge, viewport = SIZE, further = {}) =>
  browser.visit(name, `#/jobs/${id}`, async (page, faults) => {
    await page.getByRole("button", { name: /Walk through the scene/ }).click();
    await settled(page);
    await select(page).waitFor();
    await judge(page, faults);
    assert.deepEqual(await overflowing(page), []);
  }, viewport, further);

/** The canvas as a PNG. */
const shown = (page) => page.locator(".frame canvas").first().evaluate((canvas) =>
  canvas.toDataURL("image/png"));

/** The middle of the crop as the page shows it. */
const middle = (page) => Promise.all(["X", "Y", "Z"].map(async (axis) =>
  Number(await page.getByLabel(`${axis} of the crop's middle`).inputValue())));

/** Checks that a point is on the wall, at this place of the picture in CSS px. */
async function isOnWall(page, point, [x, y]) {
  const { centre, normal, radius } = wall;
  const off = point.reduce((sum, value, k) => sum + (value - centre[k]) * normal[k], 0);
  near(off, 0, 0.005 * radius, "from the wall");
  const { width, height } = await frame(page).boundingBox();
  const scale = Math.min(width / camera.width, height / camera.height);
  const [right, down, ahead] = camera.world_to_camera.slice(0, 3).map((row) =>
    row[3] + point.reduce((sum, value, k) => sum + value * row[k], 0));
  const at = (focal, slope, principal, side, length) =>
    length / 2 + scale * (focal * slope + principal - side / 2);
  near(at(camera.fx, right / ahead, camera.cx, camera.width, width), x, 1, "across the picture");
  near(at(camera.fy, down / ahead, camera.cy, camera.height, height), y, 1, "down the picture");
}

/** Where the wall is at this place of the picture in CSS px. */
async function wallAt(page, [x, y]) {
  const { width, height } = await frame(page).boundingBox();
  const scale = Math.min(width / camera.width, height / camera.height);
  const slope = (at, length, side, principal, focal) =>
    ((at - length / 2) / scale + side / 2 - principal) / focal;
  const slopes = [slope(x, width, camera.width, camera.cx, camera.fx),
    slope(y, height, camera.height, camera.cy, camera.fy), 1];
  const { axes, eye } = poseOf(camera);
  const way = [0, 1, 2].map((k) => axes.reduce((sum, axis, i) => sum + slopes[i] * axis[k], 0));
  const along = (vector) => vector.reduce((sum, value, k) => sum + value * wall.normal[k], 0);
  const far = along(wall.centre.map((value, k) => value - eye[k])) / along(way);
  return eye.map((value, k) => value + far * way[k]);
}

const picked = (page) => until("it is picked", async () =>
  !(await frame(page).getAttribute("class")).includes("aiming"));

const exported = async (page, name) => {
  const section = await unfolded(page, "Export");
  const link = section.getByRole("link", { name, exact: true });
  return new URL(await link.getAttribute("href"), server.base);
};

/** The Gaussians of a scene: where they are, and all of their numbers but the normals, as text. */
function rowsOf(bytes) {
  const { start, count, stride } = readHeader(bytes);
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  return Array.from({ length: count }, (_, i) => {
    const row = start + i * stride;
    const part = (from, to) => Buffer.from(bytes.subarray(row + from, row + to)).toString("hex");
    const place = [0, 4, 8].map((at) => view.getFloat32(row + at, true));
    return { place, text: part(0, 12) + part(24, stride) };
  });
}

/** Whether a point is inside the crop of an address. */
function isInside(crop, place) {
  const [shape, numbers] = crop.split(":");
  const [x, y, z, ...size] = numbers.split(",").map(Number);
  const away = [x, y, z].map((value, k) => place[k] - value);
  return shape === "sphere" ? Math.hypot(...away) <= size[0]
    : away.every((value, k) => Math.abs(value) <= size[k] / 2);
}

for (const [shape, sizes] of [["sphere", ["Radius"]], ["box", ["Width", "Height", "Depth"]]]) {
  test(`an exported scene has what is inside the drawn ${shape}, and the view shows that`, () =>
    opened(`crop-${shape}`, async (page) => {
      await select(page).selectOption(shape);
      await place(page).click();
      await said(page, "Choose the middle of the crop: click its surface");
      const hints = await page.locator(".thumb span:visible").allInnerTexts();
      assert.deepEqual(hints, ["Choose the middle of the crop"]);
      const { width, height } = await frame(page).boundingBox();
      const at = [Math.round(0.42 * width), Math.round(0.55 * height)];
      await frame(page).click({ position: { x: at[0], y: at[1] } });
      await picked(page);
      await settled(page);
      await isOnWall(page, await middle(page), at);
      for (const [k, name] of sizes.entries()) {
        const slider = page.getByRole("slider", { name });
        await slider.focus();
        for (let i = 0; i <= k; i++) await page.keyboard.press("ArrowRight");
      }
      await settled(page);
      await page.getByRole("button", { name: "Next photograph" }).click();
      await settled(page);
      await picture(page, `page-crop-${shape}`);
      const cropped = await shown(page);
      const asks = page.waitForRequest(/\/render$/);
      await page.getByRole("button", { name: /^Save PNG/ }).click();
      const saved = (await asks).postDataJSON();

      const address = await exported(page, "scene.ply");
      const crop = address.searchParams.get("crop");
      assert.equal(crop.split(":")[0], shape);
      assert.deepEqual(crop.split(":")[1].split(",").slice(0, 3).map(Number), await middle(page));
      assert.equal(saved.crop, crop);
      const bytes = new Uint8Array(await (await fetch(address)).arrayBuffer());
      const kept = rowsOf(wall.bytes).filter((row) => isInside(crop, row.place));
      assert.ok(kept.length > 200 && kept.length < 8000, `${kept.length} are inside`);
      const found = rowsOf(bytes);
      assert.equal(found.length, kept.length);
      assert.ok(found.every(({ text }, i) => text === kept[i].text), "exactly these");

      // The exported scene by itself gives the same picture.
      await page.route("**/artifacts/**/scene.ply", (route) =>
        route.fulfill({ body: Buffer.from(bytes) }));
      await page.getByRole("button", { name: "Close the 3D view" }).click();
      await page.getByRole("button", { name: "Export everything" }).click();
      await page.getByRole("button", { name: /Walk through the scene/ }).click();
      await settled(page);
      assert.equal(await select(page).inputValue(), "");
      await page.getByRole("button", { name: "Next photograph" }).click();
      await settled(page);
      assert.equal(await shown(page), cropped);
    }));
}

test("the links of scenes and meshes carry the crop until it is dropped", () =>
  opened("crop-links", async (page) => {
    const section = await unfolded(page, "Export");
    const cropped = () => section.locator("a[download]").evaluateAll((links) => links
      .filter(({ href }) => new URL(href).searchParams.has("crop")).map(({ download }) => download));
    assert.deepEqual(await cropped(), []);
    const notice = section.locator(".notices");
    assert.equal(await notice.isVisible(), false);
    await select(page).selectOption("box");
    await notice.getByText("cropped to the box drawn in the 3D view.").waitFor();
    const all = ["ply", "compressed.ply", "glb", "usda", "v3.spz", "spz", "sog"];
    assert.deepEqual(await cropped(),
      [...all.map((end) => `scene.${end}`), "mesh.ply", "mesh.glb"]);
    await section.locator("li", { hasText: "scene.glb" }).getByText(/^at most/).waitFor();
    const download = page.locator(".summary a[download]");
    assert.equal(await download.textContent(), "Download cropped scene");
    const { pathname, search } = new URL(await download.evaluate((link) => link.href));
    assert.match(pathname + search, /\/exports\/scene\.ply\?crop=box%3A/);
    await picture(page, "page-crop-links");
    const videos = await unfolded(page, "Videos");
    await videos.getByText("Shows only the inside of the box drawn in the 3D view.").waitFor();
    await page.route(/\/videos$/, (route) => (route.request().method() === "POST"
      ? route.fulfill({ status: 202, json: {} }) : route.continue()));
    const asks = page.waitForRequest((request) => request.method() === "POST");
    await videos.getByRole("button", { name: "Create video" }).click();
    assert.match((await asks).postDataJSON().crop, /^box:/);
    await settled(page);
    const whole = await shown(page);
    await notice.getByRole("button", { name: "Export everything" }).click();
    assert.deepEqual(await cropped(), []);
    assert.equal(await videos.getByText("drawn in the 3D view").count(), 0);
    assert.match(await download.evaluate((link) => link.href), /\/artifacts\/scene\.ply$/);
    assert.equal(await notice.isVisible(), false);
    await settled(page);
    assert.equal(await select(page).inputValue(), "");
    assert.notEqual(await shown(page), whole);
  }));

test("a mesh is saved, and a refused export shows its reason until it is shaped otherwise", () =>
  opened("crop-refused", async (page, faults) => {
    const section = await unfolded(page, "Export");
    const pressed = (name) => section.getByRole("link", { name, exact: true }).click();
    const mesh = page.waitForEvent("download");
    await pressed("mesh.ply");
    assert.equal((await mesh).suggestedFilename(), "mesh.ply");
    const bytes = readFileSync(await (await mesh).path());
    assert.equal(bytes.subarray(0, 4).toString(), "ply\n");

    await select(page).selectOption("sphere");
    await section.locator(".notices").getByText("cropped to the sphere").waitFor();
    const cropped = page.waitForEvent("download");
    await pressed("scene.ply");
    assert.equal((await cropped).suggestedFilename(), "scene.ply");
    await page.getByLabel("X of the crop's middle").fill("1e6");
    await page.keyboard.press("Tab");
    for (const [place, press] of [
      [section.locator("li", { hasText: "mesh.ply" }), () => pressed("mesh.ply")],
      [section.locator("li", { hasText: "scene.glb" }), () => pressed("scene.glb")],
      [page.locator(".summary"), () => page.locator(".summary a[download]").click()],
    ]) {
      await press();
      await place.locator(".problem", { hasText: "the scene is at" }).waitFor();
    }
    provoked(faults, 422);
    await page.getByRole("button", { name: "Export everything" }).click();
    await until("no reason is left", async () => await page.locator("p.problem:visible").count() === 0);
    await picture(page, "page-crop-refused");
  }));

test("by keys alone a crop is chosen, placed in the middle of the picture, moved and dropped", () =>
  opened("crop-keys", async (page) => {
    const before = await shown(page);
    await select(page).focus();
    await page.keyboard.press("ArrowDown");
    assert.equal(await select(page).inputValue(), "sphere");
    await place(page).focus();
    await page.keyboard.press("Enter");
    await said(page, "press Enter");
    await settled(page);
    assert.equal(await shown(page), before, "all of the scene is shown meanwhile");
    await picture(page, "page-crop-aiming");
    await page.keyboard.press("Enter");
    await picked(page);
    const { width, height } = await frame(page).boundingBox();
    const placed = await middle(page);
    await isOnWall(page, placed, [width / 2, height / 2]);
    await page.getByLabel("X of the crop's middle").focus();
    await page.keyboard.press("ArrowUp");
    const moved = await middle(page);
    assert.ok(moved[0] > placed[0] && moved[1] === placed[1], `${placed} to ${moved}`);
    // Input that is not a number changes nothing.
    await page.getByLabel("X of the crop's middle").fill("");
    await page.keyboard.press("Tab");
    assert.deepEqual(await middle(page), moved);
    // Escape gives up placing, and only then leaves the picture.
    await place(page).focus();
    await page.keyboard.press("Enter");
    await page.keyboard.press("Escape");
    assert.ok(await frame(page).evaluate((one) => one === document.activeElement));
    assert.deepEqual(await middle(page), moved);
    await select(page).selectOption("");
    await settled(page);
    assert.equal(await shown(page), before);
  }));

test("a tap places it on a phone, and a place without a surface is refused", () =>
  opened("crop-touch", async (page) => {
    await select(page).selectOption("sphere");
    await place(page).tap();
    const { width, height } = await frame(page).boundingBox();
    const at = [Math.round(0.6 * width), Math.round(0.4 * height)];
    await frame(page).tap({ position: { x: at[0], y: at[1] } });
    await picked(page);
    await isOnWall(page, await middle(page), at);
    await settled(page);
    await picture(page, "page-crop-phone");
    const placed = await middle(page);
    await place(page).tap();
    await frame(page).evaluate((one) => one.focus());
    for (let i = 0; i < 8; i++) await page.keyboard.press("ArrowLeft", { delay: 300 });
    await settled(page);
    await page.keyboard.press("Enter");
    await said(page, "There is no surface at that place");
    assert.deepEqual(await middle(page), placed);
  }, PHONE, { hasTouch: true, isMobile: true }));

const measure = (page) => page.getByRole("button", { name: "Measure", exact: true });
const metres = (page) => page.getByLabel("Their distance in metres");
const ruler = (page) => page.getByRole("group", { name: "Ruler" });
/** The measured distance. */
const unitsOf = async (page) => Number((await ruler(page).innerText()).match(/([\d.]+) units/)[1]);

for (const [name, size, further, act] of [
  ["desktop", SIZE, {}, "click"], ["phone", PHONE, { hasTouch: true, isMobile: true }, "tap"],
]) {
  test(`on a ${name} two points are measured, and their metres scale the exports`, () =>
    opened(`scale-${name}`, async (page) => {
      await measure(page)[act]();
      const { width, height } = await frame(page).boundingBox();
      const places = [[0.3, 0.35], [0.75, 0.6]]
        .map(([x, y]) => [Math.round(x * width), Math.round(y * height)]);
      for (const [i, [x, y]] of places.entries()) {
        await said(page, ["Choose the first point", "Choose the second point"][i]);
        await frame(page)[act]({ position: { x, y } });
      }
      await picked(page);
      await said(page, "Gaussians");
      const [a, b] = await Promise.all(places.map((at) => wallAt(page, at)));
      const units = Math.hypot(...a.map((value, k) => value - b[k]));
      const shownUnits = await unitsOf(page);
      near(shownUnits, units, 0.01 * units, "their distance");
      await metres(page).fill("1.2");
      await ruler(page).getByText(/1 unit is [\d.]+ m/).waitFor();
      await picture(page, `page-scale-${name}`);
      const whole = `${server.base}/v1/jobs/${id}/exports/scene.ply`;
      const scaled = await exported(page, "scene.ply");
      const scale = Number(scaled.searchParams.get("scale"));
      near(scale * shownUnits, 1.2, 0.001, "metres");
      const [one, large] = await Promise.all([whole, scaled].map(async (address) =>
        rowsOf(new Uint8Array(await (await fetch(address)).arrayBuffer()))));
      assert.equal(one.length, large.length);
      for (const [i, { place: at }] of large.entries()) {
        at.forEach((value, k) => near(value, scale * one[i].place[k], 1e-5, `Gaussian ${i}`));
      }
      const section = await unfolded(page, "Export");
      await section.getByText(`Lengths in scenes and meshes are in metres: 1 unit is ${scale} m`).waitFor();
      assert.equal((await exported(page, "colmap.zip")).search, "");
      assert.equal((await exported(page, "mesh.glb")).search, `?scale=${scale}`);
      await page.getByRole("link", { name: /^Download scene in metres, / }).waitFor();
      await section.getByRole("button", { name: "Export as it is" }).click();
      assert.equal((await exported(page, "scene.ply")).search, "");
      assert.equal(await metres(page).inputValue(), "");
    }, size, further));
}

test("by keys alone two points are measured, and a length that is none is refused", () =>
  opened("scale-keys", async (page) => {
    await measure(page).focus();
    await page.keyboard.press("Enter");
    await said(page, "Choose the first point");
    await page.keyboard.press("Enter");
    await said(page, "Choose the second point");
    await page.keyboard.press("ArrowLeft", { delay: 200 });
    await settled(page);
    await page.keyboard.press("Enter");
    await picked(page);
    await until("the length is asked for", () =>
      metres(page).evaluate((one) => one === document.activeElement));
    for (const wrong of ["0", "-3"]) {
      await metres(page).fill(wrong);
      await ruler(page).getByText("must be a positive number").waitFor();
      assert.equal((await exported(page, "scene.glb")).search, "");
    }
    await metres(page).fill("0.5");
    await ruler(page).getByText(/1 unit is/).waitFor();
    const { search } = await exported(page, "scene.glb");
    assert.match(search, /^\?scale=0\.\d+$|^\?scale=\d+\.\d+$/);
    // Another measurement is in metres.
    await measure(page).focus();
    await page.keyboard.press("Enter");
    await said(page, "Choose the first point");
    await page.keyboard.press("Enter");
    await said(page, "Choose the second point");
    await page.keyboard.press("ArrowRight", { delay: 100 });
    await settled(page);
    await page.keyboard.press("Enter");
    await picked(page);
    await until("it is in metres", async () => Number(await metres(page).inputValue()) > 0);
    const units = await unitsOf(page);
    near(Number(await metres(page).inputValue()), units * Number(search.slice(7)), 0.002, "metres");
    assert.equal((await exported(page, "scene.glb")).search, search);
    await ruler(page).getByRole("button", { name: "Clear" }).click();
    assert.equal(await ruler(page).isVisible(), false);
    assert.equal((await exported(page, "scene.glb")).search, "");
  }));
