// The scene in 3D: the same picture as the server's at the same camera, and a panel that is opened,
// navigated by pointer, keys and touch, and closed.

import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { notable } from "../../web/job/verdict.js";
import { surroundingsOf } from "../../web/scene/camera.js";
import { Browser, PHONE, loaded, overflowing, picture } from "./browser.js";
import { Stand, seen } from "./played.js";
import { colourful } from "./ply.js";
import { Server } from "./server.js";
import { until } from "./until.js";

/** Both draw by the same formulas and differ by rounding, some 60 dB; dB. */
const ALIKE = 48;
/** Different pictures of a scene agree less than this, dB. */
const FOREIGN = 30;

/** Small, as software draws every pixel, px. */
const SMALL = { width: 640, height: 460 };

let server;
let browser;
let id;
/** Index of the view that the scene starts from, the one with the best score. */
let start;

before(async () => {
  server = await Server.start(process.env.FLED);
  browser = await Browser.start(server.base);
  id = await server.submit(server.capture(), "a scene");
  await server.reached(id, "succeeded");
  start = Number(notable(await server.rounds(id)).best);
  await makeUp();
});

/** Replaces the scene of round 1 by one that is harder to draw than the blobs of a short run. */
async function makeUp() {
  const output = join(server.folder, "data", "jobs", id, "output");
  const cameras = JSON.parse(readFileSync(join(output, "cameras.json"), "utf8"));
  const { centre, radius } = surroundingsOf(cameras);
  const scene = colourful(3000, centre, radius);
  const { best_round: best } = await server.rounds(id);
  for (const path of ["rounds/1/scene.ply", ...(best === 1 ? ["scene.ply"] : [])]) {
    writeFileSync(join(output, path), scene);
  }
}

after(async () => {
  await browser?.stop();
  await server?.stop();
});

const button = (page, name) => page.getByRole("button", { name });
const frame = (page) => page.getByRole("application");
const settled = (page) => page.locator(".frame[aria-busy=false]").waitFor();
const choice = (page) => page.getByRole("combobox", { name: "photograph" });

/** Opens the scene on the job's page and passes it on once it is shown. */
const opened = (name, judge, viewport = SMALL, further = {}) =>
  browser.visit(name, `#/jobs/${id}`, async (page, faults) => {
    await button(page, /Walk through the scene/).click();
    await settled(page);
    await judge(page, faults);
    assert.deepEqual(await overflowing(page), []);
  }, viewport, further);

/** The canvas as a PNG. */
const shown = (page) => page.locator(".frame canvas").first().evaluate((canvas) =>
  canvas.toDataURL("image/png").split(",")[1]);

/** The same view rendered by the server, as a PNG, by the page's own button. */
async function rendered(page) {
  const asks = button(page, /^Save PNG/).click();
  const [download] = await Promise.all([page.waitForEvent("download"), asks]);
  return readFileSync(await download.path()).toString("base64");
}

/** PSNR of two PNGs, dB; `turn` transforms the second. */
const psnr = (page, a, b, turn = "") => page.evaluate(async ([one, other, way]) => {
  const pixels = async (text, how) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
    const { width, height } = image;
    const context = new OffscreenCanvas(width, height).getContext("2d");
    if (how === "flipped") context.setTransform(1, 0, 0, -1, 0, height);
    if (how === "mirrored") context.setTransform(-1, 0, 0, 1, width, 0);
    context.drawImage(image, 0, 0);
    return { width, height, data: context.getImageData(0, 0, width, height).data };
  };
  const [first, second] = [await pixels(one, ""), await pixels(other, way)];
  if (first.width !== second.width || first.height !== second.height) {
    throw new Error(`${first.width} x ${first.height} against ${second.width} x ${second.height}`);
  }
  let [sum, light] = [0, 0];
  for (let i = 0; i < first.data.length; i++) {
    if (i % 4 === 3) continue;
    sum += (first.data[i] - second.data[i]) ** 2;
    light += second.data[i];
  }
  const values = 0.75 * first.data.length;
  if (light / values < 8) throw new Error("the pictures are black");
  return 10 * Math.log10(255 ** 2 / Math.max(sum / values, 1e-9));
}, [a, b, turn]);

/** Chooses the last or the first entry of the slider; the sparse points come before the rounds. */
async function round(page, key, words) {
  const slider = page.getByRole("slider", { name: "round" });
  await slider.press(key);
  if (key === "Home") await slider.press("ArrowRight");
  await page.locator(".rounds", { hasText: words }).waitFor();
  await settled(page);
}

for (const [key, words] of [["Home", "Round 1"], ["End", "Round 2"]]) {
  test(`at three cameras ${words} is the server's own picture, the right way up`, (context) =>
    opened(`scene-${key}`, async (page) => {
      await round(page, key, words);
      const pictures = [];
      for (const at of ["0", "3", "7"]) {
        await choice(page).selectOption(at);
        await settled(page);
        const [ours, theirs] = [await shown(page), await rendered(page)];
        const alike = await psnr(page, ours, theirs);
        context.diagnostic(`camera ${at}: ${alike.toFixed(1)} dB`);
        assert.ok(alike > ALIKE, `camera ${at}: ${alike} dB`);
        for (const turn of ["flipped", "mirrored"]) {
          const foreign = await psnr(page, ours, theirs, turn);
          assert.ok(foreign < FOREIGN, `${turn}, camera ${at}: ${foreign} dB`);
        }
        for (const other of pictures) {
          const foreign = await psnr(page, ours, other);
          assert.ok(foreign < FOREIGN, `two cameras: ${foreign} dB`);
        }
        pictures.push(theirs);
      }
    }));
}

test("a stop brighter or two darker it matches the server's picture", (context) =>
  opened("scene-exposure", async (page) => {
    await round(page, "Home", "Round 1");
    const slider = page.getByRole("slider", { name: "exposure" });
    const before = await shown(page);
    for (const [ev, words] of [["1", "+1.00 EV"], ["-2", "−2.00 EV"]]) {
      await slider.fill(ev);
      await page.locator(".exposure", { hasText: words }).waitFor();
      await settled(page);
      const [ours, theirs] = [await shown(page), await rendered(page)];
      const alike = await psnr(page, ours, theirs);
      context.diagnostic(`${words}: ${alike.toFixed(1)} dB`);
      assert.ok(alike > ALIKE, `${words}: ${alike} dB`);
      const foreign = await psnr(page, ours, before);
      assert.ok(foreign < FOREIGN, `${words} is as without: ${foreign} dB`);
    }
  }));

test("with a wider lens it matches the server's picture, and a photograph's camera restores its own", () =>
  opened("scene-lens", async (page) => {
    await round(page, "Home", "Round 1");
    const slider = page.getByRole("slider", { name: "Field of view" });
    const [own, before] = [await slider.inputValue(), await shown(page)];
    await slider.fill(String(Number(own) + 25));
    await page.locator(".lens", { hasText: `${Number(own) + 25}° view` }).waitFor();
    await settled(page);
    const [ours, theirs] = [await shown(page), await rendered(page)];
    const alike = await psnr(page, ours, theirs);
    assert.ok(alike > ALIKE, `${alike} dB`);
    assert.ok((await psnr(page, ours, before)) < FOREIGN, "it is wider");
    await button(page, "Back to the best view").click();
    await settled(page);
    assert.deepEqual([await slider.inputValue(), await shown(page)], [own, before]);
  }));

test("the speed scales movement by keys", () =>
  opened("scene-speed", async (page) => {
    const slider = page.getByRole("slider", { name: "Speed" });
    await slider.fill("3");
    await page.locator(".speed", { hasText: "8× speed" }).waitFor();
    const at = await shown(page);
    await frame(page).focus();
    await page.keyboard.press("KeyS", { delay: 200 });
    await settled(page);
    const far = await psnr(page, at, await shown(page));
    await button(page, "Back to the best view").click();
    await settled(page);
    await slider.fill("-3");
    await frame(page).focus();
    await page.keyboard.press("KeyS", { delay: 200 });
    await settled(page);
    const near = await psnr(page, at, await shown(page));
    assert.ok(near > far, `${near} dB near, ${far} dB far`);
  }));

test("portrait photographs fill the frame, and a saved picture is named by job and view", async () => {
  const turned = (camera) => ({ ...camera, width: camera.height, height: camera.width, cx: camera.cy, cy: camera.cx });
  await browser.visit("scene-portrait", "#/captures", async (page) => {
    await page.route("**/artifacts/cameras.json", async (route) => {
      const cameras = await (await route.fetch()).json();
      await route.fulfill({ json: cameras.map(turned) });
    });
    await page.goto(`${server.base}/#/jobs/${id}`);
    await button(page, /Walk through the scene/).click();
    await settled(page);
    const [inner, outer] = [await frame(page).boundingBox(), await page.locator(".band").boundingBox()];
    assert.ok(inner.width > outer.width - 2 && inner.width > inner.height, `${inner.width} of ${outer.width} px`);
    const save = async () => {
      const asks = button(page, /^Save PNG/).click();
      return (await Promise.all([page.waitForEvent("download"), asks]))[0].suggestedFilename();
    };
    assert.match(await save(), new RegExp(`^a-scene-00${start}-round-[12]\\.png$`));
    await frame(page).focus();
    await page.keyboard.press("KeyS", { delay: 100 });
    await settled(page);
    assert.match(await save(), /^a-scene-free-view-round-[12]\.png$/);
  }, { width: 1000, height: 800 });
});

test("a novel view matches the server's picture, on a high-density screen", (context) =>
  opened("scene-free", async (page) => {
    await round(page, "Home", "Round 1");
    await frame(page).focus();
    await page.keyboard.press("ArrowLeft", { delay: 200 });
    await page.keyboard.press("KeyS", { delay: 300 });
    await settled(page);
    assert.equal(await choice(page).inputValue(), "-1");
    const alike = await psnr(page, await shown(page), await rendered(page));
    context.diagnostic(`free view: ${alike.toFixed(1)} dB`);
    assert.ok(alike > ALIKE, `${alike} dB`);
  }, SMALL, { deviceScaleFactor: 2 }));

test("the view turns, pans and zooms, and nothing is drawn while nothing changes", () =>
  opened("scene-moves", async (page) => {
    const box = await frame(page).boundingBox();
    const middle = [box.x + box.width / 2, box.y + box.height / 2];
    let before = await shown(page);
    const changes = async (what, does) => {
      await does();
      await settled(page);
      const now = await shown(page);
      assert.notEqual(now, before, what);
      before = now;
    };
    const drag = (which) => async () => {
      await page.mouse.move(...middle);
      await page.mouse.down({ button: which });
      await page.mouse.move(middle[0] + 60, middle[1] + 20, { steps: 3 });
      await page.mouse.up({ button: which });
    };
    await changes("turned", drag("left"));
    await changes("shifted", drag("right"));
    await changes("nearer", () => page.mouse.wheel(0, -200));
    for (const key of ["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE", "ArrowUp", "ArrowRight"]) {
      await changes(key, () => page.keyboard.press(key, { delay: 120 }));
    }
    const frames = await page.evaluate(async () => {
      const real = window.requestAnimationFrame;
      let many = 0;
      window.requestAnimationFrame = (does) => { many += 1; return real(does); };
      await new Promise((resolve) => { setTimeout(resolve, 600); });
      window.requestAnimationFrame = real;
      return many;
    });
    assert.equal(frames, 0, "at rest");
    await changes("reset", () => button(page, "Back to the best view").click());
    await button(page, "Next photograph").click();
    await settled(page);
    assert.equal(await choice(page).inputValue(), String((start + 1) % 8));
    await button(page, "Previous photograph").click();
    await settled(page);
    assert.equal(await choice(page).inputValue(), String(start));
    assert.equal(await shown(page), before, "back where one was");
  }));

test("the wheel scrolls the page until the scene has the focus, and again after Escape", () =>
  opened("scene-wheel", async (page) => {
    const scrolled = () => page.evaluate(() => scrollY);
    await page.keyboard.press("Escape");
    await frame(page).hover();
    const before = await scrolled();
    await page.mouse.wheel(0, 60);
    await until("the page scrolls", async () => (await scrolled()) === before + 60);
    await settled(page);
    const picture = await shown(page);
    const place = await scrolled();
    await page.keyboard.down("Control");
    await page.mouse.wheel(0, 60);
    await page.keyboard.up("Control");
    await until("it is farther", async () => (await shown(page)) !== picture);
    await frame(page).click();
    await page.mouse.wheel(0, 60);
    await settled(page);
    assert.equal(await scrolled(), place);
    // High enough that the click does not scroll.
  }, { ...SMALL, height: 700 }));

test("the photographs' cameras are drawn as lines", () =>
  opened("scene-cameras", async (page) => {
    await frame(page).focus();
    await page.keyboard.press("KeyS", { delay: 1200 });
    await page.getByLabel("Cameras").check();
    await settled(page);
    const lines = page.locator(".frame .lines");
    const painted = await lines.evaluate((canvas) => {
      const { width, height } = canvas;
      const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
      return data.filter((value, i) => i % 4 === 3 && value > 0).length;
    });
    assert.ok(painted > 100, "there are lines");
    await picture(page, "page-scene-cameras");
    await page.getByLabel("Cameras").uncheck();
    await until("they are gone", async () => (await lines.isVisible()) === false);
  }));

test("touch turns and pinches, and a vertical swipe scrolls until the scene is tapped", () =>
  opened("scene-touch", async (page) => {
    const hint = page.locator(".thumb");
    await hint.getByText("One finger turns, two pan and zoom").waitFor();
    const action = () => frame(page).evaluate((node) => getComputedStyle(node).touchAction);
    await page.locator("h1").tap();
    await frame(page).evaluate((node) => node.blur());
    assert.equal(await action(), "pan-y");
    await hint.getByText("Tap to move through the scene").waitFor();
    await frame(page).tap();
    assert.equal(await action(), "none");
    await settled(page);
    const before = await shown(page);
    const box = await frame(page).boundingBox();
    const session = await page.context().newCDPSession(page);
    const touch = (type, ...points) => session.send("Input.dispatchTouchEvent", {
      type,
      touchPoints: points.map(([x, y], id) =>
        ({ id, x: box.x + box.width * x, y: box.y + box.height * y })),
    });
    await touch("touchStart", [0.4, 0.5]);
    await touch("touchStart", [0.4, 0.5], [0.6, 0.5]);
    await touch("touchMove", [0.3, 0.5], [0.7, 0.5]);
    await touch("touchMove", [0.2, 0.5], [0.8, 0.5]);
    await touch("touchEnd");
    await settled(page);
    assert.notEqual(await shown(page), before, "pinched");
    assert.equal(await hint.locator("span:visible").count(), 0, "the hint is shown only once");
    await picture(page, "page-scene-phone");
  }, PHONE, { hasTouch: true, isMobile: true }));

for (const [name, size, further] of [
  ["desktop", { width: 1440, height: 900 }, {}],
  ["portrait", { width: 390, height: 844 }, { hasTouch: true, isMobile: true }],
  ["landscape", { width: 844, height: 390 }, { hasTouch: true, isMobile: true }],
]) {
  test(`opened on a screen of ${size.width} x ${size.height} px, canvas, tools and hint are all in the window`, () =>
    opened(`scene-fits-${name}`, async (page) => {
      for (const part of [".band", ".stage .controls", ".thumb span:visible"]) {
        const box = await page.locator(part).boundingBox();
        assert.ok(box.y >= 0 && box.y + box.height <= size.height, `${part}: ${box.y} to ${box.y + box.height} px`);
        // The bar of the page's parts stays at the top.
        assert.ok(box.y >= (await page.locator(".contents").boundingBox()).height, `${part} is below the bar`);
      }
      const { height } = await page.locator(".band").boundingBox();
      assert.ok(height >= 150, `the picture is ${height} px high`);
    }, size, further));
}

test("with a mouse the hint goes with the first drag", () =>
  opened("scene-hint", async (page) => {
    const hint = page.locator(".thumb span:visible");
    await seen(hint, "Drag to turn");
    const box = await frame(page).boundingBox();
    await page.mouse.move(box.x + 100, box.y + 100);
    await page.mouse.down();
    await page.mouse.move(box.x + 160, box.y + 100, { steps: 3 });
    await page.mouse.up();
    await until("it is gone", async () => (await hint.count()) === 0);
  }));

test("it can be closed, opened again and left, and ends its worker", () =>
  opened("scene-closed", async (page) => {
    assert.equal(page.workers().length, 1);
    await button(page, "Close the 3D view").click();
    await until("the worker is gone", () => page.workers().length === 0);
    await button(page, /Walk through the scene/).press("Enter");
    await settled(page);
    await page.getByRole("link", { name: "Captures" }).click();
    await until("the worker is gone", () => page.workers().length === 0);
  }));

test("a lost context is reported, and the scene can be opened again", () =>
  opened("scene-lost", async (page) => {
    await page.locator(".frame canvas").first().evaluate((canvas) =>
      canvas.getContext("webgl2").getExtension("WEBGL_lose_context").loseContext());
    await page.getByText("The graphics adapter dropped the picture").waitFor();
    await picture(page, "page-scene-lost");
    await button(page, /Walk through the scene/).click();
    await settled(page);
  }));

test("without WebGL 2 the page says what to do, and loads nothing of the view", () =>
  browser.visit("scene-none", `#/jobs/${id}`, async (page) => {
    await button(page, /Walk through the scene/).waitFor();
    await until("the poster is there", () => loaded(page.locator(".poster img")));
    const asked = await page.evaluate(() => performance.getEntriesByType("resource")
      .map(({ name }) => new URL(name).pathname).filter((path) => path.includes("/scene/")));
    assert.deepEqual(asked.map((path) => path.replace(/^\/assets\/[0-9a-f]{16}/, "")), ["/scene/panel.js"]);
    await page.evaluate(() => { HTMLCanvasElement.prototype.getContext = () => null; });
    await button(page, /Walk through the scene/).click();
    await page.getByText("This browser does not support WebGL 2").waitFor();
    assert.deepEqual(await overflowing(page), []);
  }));

test("a file that is no scene gives a sentence", async () => {
  const stand = await Stand.start();
  try {
    await stand.visit("scene-foreign", `#/jobs/${await stand.finished()}`, async (page) => {
      await button(page, /Walk through the scene/).click();
      await page.getByText("The scene cannot be shown. This is not a PLY file").waitFor();
    });
  } finally {
    await stand.stop();
  }
});
