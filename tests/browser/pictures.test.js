// The pictures of a view and the novel view: keyboard, touch, wheel and brightness, at both widths.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { amplify } from "../../web/lib/difference.js";
import { gains, mean } from "../../web/lib/light.js";
import { loaded, picture, withoutWebGl } from "./browser.js";
import { Stand, both, button, part, seen } from "./played.js";
import { until } from "./until.js";

let stand;

before(async () => { stand = await Stand.start(); });

after(() => stand?.stop());

/** Opens the section "Views" of a finished job with its pictures loaded. */
async function views(name, width, judge, further = {}) {
  const id = await stand.finished();
  await stand.visit(name, `#/jobs/${id}`, async (page) => {
    const root = part(page, "Views");
    const slider = root.getByRole("slider");
    await until("both sides are there", () => loaded(slider.locator("img")));
    await part(page, "Files").waitFor();
    await judge({ page, root, slider, at: async () => Number(await slider.getAttribute("aria-valuenow")) });
  }, width, further);
}

const scale = (root) => root.locator(".tools .soft").textContent();

both("thumbnails can be put on either side by keyboard", (width) =>
  views("keyboard", width, async ({ page, root, slider }) => {
    const shots = root.locator(".shot");
    await shots.first().focus();
    await page.keyboard.press("ArrowRight");
    await page.keyboard.press("Enter");
    await seen(slider.locator(".left"), "round 1, enhanced");
    assert.equal(await shots.nth(1).evaluate((one) => one === document.activeElement), true);
    await page.keyboard.press("End");
    await page.keyboard.press("Shift+Enter");
    await seen(slider.locator(".right"), "ground truth");
    await page.keyboard.press("Home");
    await button(root, "right").press("Enter");
    await shots.first().press(" ");
    await seen(slider.locator(".right"), "photograph");
    await page.keyboard.press("ArrowDown");
    assert.equal(await shots.first().evaluate((one) => one === document.activeElement), false);
    assert.match(await shots.first().innerText(), /right/);
    await until("the pictures are there", () => loaded(slider.locator("img")));
  }));

test("both sides are chosen by touch, and a vertical swipe scrolls the page", () =>
  views("touch", "phone", async ({ root, slider }) => {
    await button(root, "right").tap();
    await root.locator("figure", { hasText: "round 1, deblurred" }).getByRole("button").tap();
    await seen(slider.locator(".right"), "round 1, deblurred");
    await button(root, "left").tap();
    await root.locator("figure", { hasText: "ground truth" }).getByRole("button").tap();
    await seen(slider.locator(".left"), "ground truth");
    const action = (node) => getComputedStyle(node).touchAction;
    assert.equal(await slider.evaluate(action), "pan-y");
  }, { hasTouch: true, isMobile: true }));

both("keys move the bar to its ends, and zoom, move and reset the picture", (width) =>
  views("keys", width, async ({ page, root, slider, at }) => {
    await slider.press("Home");
    assert.equal(await at(), 0);
    await slider.press("End");
    assert.equal(await at(), 100);
    await slider.press("ArrowLeft");
    assert.equal(await at(), 95);
    await slider.press("+");
    assert.equal(await scale(root), "1.5 ×");
    const moved = () => slider.locator("img").first().evaluate((image) => image.style.transform);
    const before = await moved();
    await slider.press("Shift+ArrowRight");
    assert.notEqual(await moved(), before);
    assert.equal(await at(), 95, "the bar stays");
    await slider.press("-");
    assert.equal(await scale(root), "1.0 ×");
    await slider.press("+");
    await slider.press("0");
    assert.equal(await scale(root), "1.0 ×");
    await button(root, "Zoom in").click();
    await button(root, "Zoom in").click();
    await picture(page, `page-enlarged-${width}`);
    await button(root, "Fit picture").click();
    assert.equal(await scale(root), "1.0 ×");
    await slider.dblclick();
    assert.equal(await scale(root), "2.3 ×");
    assert.equal(await at(), 95, "a double click does not move the bar");
    await slider.dblclick();
    assert.equal(await scale(root), "1.0 ×");
  }));

both("a zoomed picture can be dragged, and the bar only at its own place", (width) =>
  views("drag", width, async ({ page, root, slider, at }) => {
    await button(root, "Zoom in").click();
    const before = await at();
    const shift = () => slider.locator("img").first().evaluate((image) => image.style.transform);
    const corner = await shift();
    await slider.scrollIntoViewIfNeeded();
    const box = await slider.boundingBox();
    const drag = async (from, to) => {
      await page.mouse.move(box.x + box.width * from, box.y + box.height / 2);
      await page.mouse.down();
      await page.mouse.move(box.x + box.width * to, box.y + box.height / 2, { steps: 3 });
      await page.mouse.up();
    };
    await drag(0.25, 0.15);
    assert.notEqual(await shift(), corner);
    assert.equal(await at(), before);
    await drag(0.5, 0.75);
    assert.ok(Math.abs((await at()) - 75) <= 1, `the bar is at ${await at()}`);
  }));

both("the wheel over the pictures scrolls the page, and zooms with Ctrl", (width) =>
  views("wheel", width, async ({ page, root, slider }) => {
    await over(page, slider);
    await scrolls(page);
    await over(page, slider);
    await page.keyboard.down("Control");
    await page.mouse.wheel(0, -100);
    await page.keyboard.up("Control");
    await until("it is enlarged", async () => (await scale(root)) === "1.2 ×");
    // The last step out zooms the picture, the next ones scroll the page.
    await page.mouse.wheel(0, 100);
    await until("it is whole", async () => (await scale(root)) === "1.0 ×");
    await scrolls(page);
  }));

both("the wheel over the novel view scrolls the page until a click into the view", (width) =>
  views("novel-wheel", width, async ({ page }) => {
    const map = page.getByAltText("Cameras and sparse points from above");
    assert.equal(await part(page, "Novel view").count(), 0, "the scene itself turns");
    assert.equal(await map.count(), 0, "and shows the cameras");
    await withoutWebGl(page);
    await map.waitFor({ state: "attached" });
    const novel = part(page, "Novel view");
    const frame = novel.getByLabel("Novel view: use the arrow keys to turn");
    await seen(novel, "distance 1.00");
    await over(page, frame);
    await scrolls(page);
    await seen(novel, "distance 1.00");
    await over(page, frame);
    await page.mouse.down();
    await page.mouse.up();
    const before = await page.evaluate(() => scrollY);
    await page.mouse.wheel(0, 100);
    await seen(novel, "distance 1.08");
    assert.equal(await page.evaluate(() => scrollY), before);
    await page.mouse.move(2, 2);
    await over(page, frame);
    await scrolls(page);
    await button(novel, "Turn right").press("Enter");
    await seen(novel, "azimuth 10°");
    await button(novel, "Reset").click();
    await seen(novel, "azimuth 0°, elevation 0°, distance 1.00");
  }));

both("input and render are shown at the same brightness, and the page says how", (width) =>
  views("equal", width, async ({ page, root, slider }) => {
    const filters = () => slider.locator("img").evaluateAll((images) => images.map((image) => image.style.filter));
    assert.deepEqual(await filters(), ["", ""]);
    await root.getByLabel("Match brightness").check();
    await seen(root.getByRole("status"), /^photograph is brightened × \d+\.\d to match the other side/);
    const [below, top] = await filters();
    assert.equal(below, "");
    assert.match(top, /^brightness\(\d/);
    await picture(page, `page-equal-${width}`);
    // The shown picture is brightened, also after another choice.
    await root.locator("figure", { hasText: "ground truth" }).getByRole("button").click();
    await until("now the render is the darker one", async () => (await filters())[1] === "");
    await root.getByLabel("Match brightness").uncheck();
    assert.deepEqual(await filters(), ["", ""]);
  }));

/** Zoom and shift of every picture of the view: one entry if all agree. */
const shown = async (root) => [...new Set(await root.locator(".compare img, .shot img")
  .evaluateAll((images) => images.map((image) => image.style.transform)))];

both("zooming one picture of a view zooms all of them to the same part", (width) =>
  views("together", width, async ({ page, root, slider }) => {
    const frame = root.locator(".shot .frame").nth(1);
    await frame.scrollIntoViewIfNeeded();
    await until("thumbnails are there", () => loaded(root.locator(".shot img").nth(1)));
    assert.equal((await shown(root)).length, 1);
    await over(page, frame);
    await scrolls(page);
    await over(page, frame);
    await page.keyboard.down("Control");
    await page.mouse.wheel(0, -100);
    await page.keyboard.up("Control");
    await until("all are enlarged", async () => (await scale(root)) === "1.2 ×");
    const [first, ...others] = await shown(root);
    assert.deepEqual(others, []);
    assert.match(first, /scale\(1\.2\)/);
    // After a click the wheel zooms the picture.
    const left = await slider.locator(".left").textContent();
    await over(page, frame);
    await page.mouse.click(...await middle(frame));
    await page.mouse.wheel(0, -100);
    await until("further", async () => (await scale(root)) === "1.4 ×");
    assert.notEqual(await slider.locator(".left").textContent(), left, "a click chooses");
    const [before] = await shown(root);
    const chosen = await slider.locator(".left").textContent();
    const [x, y] = await middle(frame);
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + 30, y + 10, { steps: 4 });
    await page.mouse.up();
    const moved = await shown(root);
    assert.equal(moved.length, 1);
    assert.notEqual(moved[0], before);
    assert.equal(await slider.locator(".left").textContent(), chosen, "a drag chooses nothing");
    await root.locator(".shot").first().press("+");
    assert.equal(await scale(root), "2.2 ×");
    await root.locator(".shot").first().press("0");
    assert.deepEqual(await shown(root), ["translate(0%, 0%) scale(1)"]);
  }));

test("two fingers zoom and move all pictures of a view", () =>
  views("pinch", "phone", async ({ page, root, slider, at }) => {
    const fingers = await page.context().newCDPSession(page);
    const touch = (type, ...points) => fingers.send("Input.dispatchTouchEvent",
      { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
    const frames = { slider, thumbnail: root.locator(".shot .frame").first() };
    for (const [name, frame] of Object.entries(frames)) {
      await frame.scrollIntoViewIfNeeded();
      const bar = await at();
      const [x, y] = await middle(frame);
      await touch("touchStart", [x - 15, y]);
      await touch("touchStart", [x - 15, y], [x + 15, y]);
      for (const far of [20, 25, 30]) await touch("touchMove", [x - far, y], [x + far, y]);
      await touch("touchEnd");
      await until(`enlarged by the ${name}`, async () => (await scale(root)) === "2.0 ×");
      assert.equal((await shown(root)).length, 1);
      if (name === "thumbnail") assert.equal(await at(), bar);
      await button(root, "Fit picture").click();
    }
  }, { hasTouch: true, isMobile: true }));

both("equal brightness holds for all pictures of the view", (width) =>
  views("all-equal", width, async ({ page, root }) => {
    const images = root.locator(".shot img");
    for (const one of await images.all()) await one.scrollIntoViewIfNeeded();
    await until("all are there", () => loaded(images));
    await root.getByLabel("Match brightness").check();
    const gains = () => images.evaluateAll((all) => all.map((one) => Number(one.style.filter.match(/[\d.]+/)?.[0] ?? 1)));
    const [dark, ...rest] = await gains();
    assert.ok(dark > 2, `the input × ${dark}`);
    assert.equal(rest.at(-1), 1, "the truth is the brightest");
    assert.ok(rest[0] > 1 && rest[0] < dark);
    await picture(page, `page-all-equal-${width}`);
    await root.getByRole("combobox", { name: "view" }).selectOption("003");
    for (const one of await images.all()) await one.scrollIntoViewIfNeeded();
    await until("another view, too", async () => (await loaded(images)) && (await gains())[0] > 2);
    await root.getByLabel("Match brightness").uncheck();
    assert.equal(Math.max(...await gains()), 1);
  }));

both("the server renders depth once the row of pictures is near", (width) =>
  views("depth", width, async ({ page, root, slider }) => {
    const depth = root.locator("figure", { hasText: "round 2, depth" });
    await depth.scrollIntoViewIfNeeded();
    await until("it is rendered", () => loaded(depth.locator("img")));
    // The played depth is much brighter than the played view.
    assert.ok((await brightness(depth.locator("img"))) > 0.85);
    await depth.getByRole("button").click();
    await seen(slider.locator(".left"), "round 2, depth");
    if (width === "phone") await root.getByText("Viewing tips").click();
    await seen(root, "near is bright, far is dark");
    await picture(page, `page-depth-${width}`);
  }));

/** Mean of an unmodified picture, 0..=1. */
const brightness = (image) => image.evaluate((one) => {
  const canvas = new OffscreenCanvas(one.naturalWidth, one.naturalHeight);
  const context = canvas.getContext("2d");
  context.drawImage(one, 0, 0);
  const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
  return data.reduce((sum, value, i) => (i % 4 === 3 ? sum : sum + value), 0) / (0.75 * data.length * 255);
});

both("the difference from ground truth is a picture that is never brightened", (width) =>
  views("difference", width, async ({ page, root, slider }) => {
    const shot = (label) => root.locator("figure", { hasText: label });
    const made = shot("restored − truth, × 4");
    await made.scrollIntoViewIfNeeded();
    await until("it is made", () => loaded(root.locator(".shot img")));
    // The played render is the ground truth with nine tenths of its light.
    const [far, truth] = [await brightness(made.locator("img")), await brightness(shot("ground truth").locator("img"))];
    assert.ok(Math.abs(far - 0.4 * truth) < 0.03, `${far} of ${truth}`);
    await made.getByRole("button").click();
    await seen(slider.locator(".left"), "restored − truth, × 4");
    await until("it is compared", () => loaded(slider.locator("img")));
    await root.getByLabel("Match brightness").check();
    await seen(root.getByRole("status"), "Difference and depth pictures are not brightened.");
    assert.equal(await made.locator("img").evaluate((one) => one.style.filter), "");
    if (width === "phone") await root.getByText("Viewing tips").click();
    await picture(page, `page-difference-${width}`);
    // The choice is kept for another view, and the difference made again.
    const before = await slider.locator(".top img").getAttribute("src");
    await root.getByRole("combobox", { name: "view" }).selectOption("003");
    await until("another one", async () => (await slider.locator(".top img").getAttribute("src")) !== before);
    await until("which is there", () => loaded(slider.locator("img")));
    await seen(slider.locator(".left"), "restored − truth, × 4");
  }));

both("without ground truth renders are compared with the enhanced photographs, and the page says so", async (width) => {
  await stand.visit("difference-untrue", `#/jobs/${await stand.untold()}`, async (page) => {
    const root = part(page, "Views");
    const made = root.locator("figure", { hasText: "round 2, rendered − enhanced, × 4" });
    await made.scrollIntoViewIfNeeded();
    await until("it is made", () => loaded(made.locator("img")));
    assert.ok((await brightness(made.locator("img"))) > 0.02);
    assert.equal(await root.locator("figure", { hasText: "truth" }).count(), 0);
    if (width === "phone") await root.getByText("Viewing tips").click();
    await seen(root, "where they disagree, not which of them is wrong");
    await part(page, "Files").waitFor();
  }, width);
});

test("a difference has no sign, a gain of four, and is clipped at white", () => {
  const one = Uint8ClampedArray.of(10, 20, 30, 9, 0, 0, 0, 0);
  amplify(one, Uint8ClampedArray.of(5, 40, 30, 200, 255, 0, 1, 0));
  assert.deepEqual([...one], [20, 80, 0, 255, 255, 0, 4, 255]);
});

test("a gain raises the darker picture to the mean of the brighter, though some of it is clipped", () => {
  const dark = [0.01, 0.05, 0.1, 0.4];
  const bright = [0.2, 0.5, 0.6, 0.9];
  const [gain, other] = gains(dark, bright);
  assert.equal(other, 1);
  assert.ok(Math.abs(mean(dark, gain) - mean(bright)) < 1e-4);
  assert.ok(gain > mean(bright) / mean(dark), "what is clipped is made up for");
  assert.deepEqual(gains(bright, dark), [1, gain]);
  assert.deepEqual(gains([0, 0], [0, 0]), [1, 1]);
});

/** Centre of an element, px. */
async function middle(locator) {
  const box = await locator.boundingBox();
  return [box.x + box.width / 2, box.y + box.height / 2];
}

/** Moves the pointer to the centre of an element. */
async function over(page, locator) {
  await locator.scrollIntoViewIfNeeded();
  const box = await locator.boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
}

/** Checks that a turn of the wheel scrolls the page. */
async function scrolls(page) {
  const before = await page.evaluate(() => scrollY);
  await page.mouse.wheel(0, 60);
  await until("the page scrolls", async () => (await page.evaluate(() => scrollY)) > before);
}
