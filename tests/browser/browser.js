// Debian's Chromium, and pages that write down whatever goes wrong on them.

import assert from "node:assert/strict";
import { join } from "node:path";

import { chromium } from "playwright-core";

import { PATIENCE } from "./until.js";

/** The folder of the pictures. */
export const SCREENSHOTS = join(import.meta.dirname, "screenshots");

const ARGUMENTS = [
  "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
  "--disable-background-networking", "--disable-component-update", "--disable-sync",
  // WebGL by software, as the scene in 3D wants it.
  "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
  // A wheel's turn is over at once: what is measured next does not move under the test.
  "--disable-smooth-scrolling",
];

/** px */
export const DESKTOP = { width: 1200, height: 900 };
/** A small phone of today, px. */
export const PHONE = { width: 360, height: 740 };

export class Browser {
  /** A browser that looks at the server at `base`. */
  static async start(base) {
    const executablePath = process.env.CHROMIUM ?? "/usr/bin/chromium";
    return new Browser(base, await chromium.launch({ executablePath, args: ARGUMENTS }));
  }

  constructor(base, chromium) {
    Object.assign(this, { base, chromium });
  }

  stop() {
    return this.chromium.close();
  }

  /**
   * Opens the page at `hash`, hands it to `judge(page, faults)` and fails when it had any fault in
   * the end. Leaves a picture of its last state, whatever came out: `screenshots/NAME.png`.
   */
  async visit(name, hash, judge, viewport = DESKTOP, further = {}) {
    const context = await this.chromium.newContext({ viewport, acceptDownloads: true, ...further });
    context.setDefaultTimeout(PATIENCE);
    const page = await context.newPage();
    const faults = watch(page, this.base);
    if (process.env.WEB) await fromTree(page, this.base, process.env.WEB);
    if (this.isReady) await page.route("**/readyz", (route) => route.fulfill({ json: { checks: [] } }));
    try {
      await page.goto(`${this.base}/${hash}`);
      await judge(page, faults);
      assert.deepEqual(faults, [], "faults of the page");
    } finally {
      await picture(page, name);
      await context.close();
    }
  }
}

/** A picture of a page as it is now: `screenshots/NAME.png`. */
export const picture = (page, name) => page.screenshot({ path: join(SCREENSHOTS, `${name}.png`), fullPage: true });

/** What goes wrong on a page from now on, a line each. */
function watch(page, base) {
  const faults = [];
  page.on("console", (message) => {
    // Without a GPU what WebGL draws is read back to be shown, and each time it warns of that.
    if (message.text().includes("GL Driver Message (OpenGL, Performance")) return;
    if (["error", "warning"].includes(message.type())) {
      faults.push(`console: ${message.text()}`);
    }
  });
  page.on("pageerror", (error) => faults.push(`script: ${error.message}`));
  page.on("request", (request) => {
    const { protocol, origin } = new URL(request.url());
    if (protocol !== "data:" && origin !== base) faults.push(`outside: ${request.url()}`);
  });
  page.on("requestfailed", (request) => {
    const reason = request.failure()?.errorText;
    // The page itself breaks a request off: it goes to another address, shows another picture, or
    // its player wants another part of the file. What the server or the network breaks has another
    // reason.
    if (reason === "net::ERR_ABORTED") return;
    faults.push(`failed: ${request.url()}: ${reason}`);
  });
  page.on("response", (response) => {
    if (response.status() < 400) return;
    const { pathname } = new URL(response.url());
    faults.push(`answer: ${response.status()} ${response.request().method()} ${pathname}`);
  });
  return faults;
}

/** The page's own files from a folder and not from the program: to work on them without a build. */
async function fromTree(page, base, folder) {
  const own = (url) => url.origin === base && /^\/(assets\/.*)?$/.test(url.pathname);
  await page.route(own, (route) => {
    const { pathname } = new URL(route.request().url());
    const name = pathname.replace(/^\/(assets\/([0-9a-f]{16}\/)?)?/, "") || "index.html";
    return route.fulfill({ path: join(folder, name) });
  });
}

/** What reaches over the right edge of the window and is not scrolled by an element of its own. */
export function overflowing(page) {
  return page.evaluate(() => {
    const width = document.documentElement.clientWidth;
    const clips = (node) => getComputedStyle(node).overflowX !== "visible";
    const clipped = (node) => {
      for (let up = node.parentElement; up && up !== document.body; up = up.parentElement) {
        if (clips(up)) return true;
      }
      return false;
    };
    const over = [...document.body.querySelectorAll("*")]
      .filter((node) => node.getBoundingClientRect().right > width + 0.5 && !clipped(node))
      .map((node) => {
        const words = node.textContent.trim().slice(0, 40);
        return `${node.tagName.toLowerCase()}.${node.getAttribute("class") ?? ""} "${words}"`;
      });
    const scrolls = document.documentElement.scrollWidth > width;
    return scrolls && over.length === 0 ? ["the page scrolls sideways"] : over;
  });
}

/** Opens the page anew as a browser without WebGL. */
export async function withoutWebGl(page) {
  await page.addInitScript(() => {
    const real = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, ...further) {
      return kind === "webgl2" ? null : real.call(this, kind, ...further);
    };
  });
  await page.reload();
}

/** Whether every picture in `locator` is there. */
export async function loaded(locator) {
  const sizes = await locator.evaluateAll((images) => images.map((image) => image.naturalWidth));
  return sizes.length > 0 && sizes.every((size) => size > 0);
}

/** Share of the picture that a canvas holds which is not as its corner is. */
export const drawn = (canvas) => canvas.evaluate((one) => {
  const copy = new OffscreenCanvas(one.width, one.height).getContext("2d");
  copy.drawImage(one, 0, 0);
  const { data } = copy.getImageData(0, 0, one.width, one.height);
  const differs = (at) => [0, 1, 2, 3].some((k) => Math.abs(data[at + k] - data[k]) > 24);
  let count = 0;
  for (let at = 0; at < data.length; at += 4) count += differs(at) ? 1 : 0;
  return (4 * count) / data.length;
});
