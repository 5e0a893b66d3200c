// Debian's Chromium without windows, and pages that record their faults.

import assert from "node:assert/strict";
import { join } from "node:path";

import { chromium } from "playwright-core";

import { PATIENCE } from "./until.js";

/** The folder of screenshots. */
export const SCREENSHOTS = join(import.meta.dirname, "screenshots");

const ARGUMENTS = [
  "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
  "--disable-background-networking", "--disable-component-update", "--disable-sync",
  // WebGL in software, for the 3D scene.
  "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
  // A turn of the wheel ends at once, so that the next measurement does not see it move.
  "--disable-smooth-scrolling",
];

/** px */
export const DESKTOP = { width: 1200, height: 900 };
/** A small current phone, px. */
export const PHONE = { width: 360, height: 740 };

export class Browser {
  /**
   * Starts a browser for the server at `base`. Full Chromium takes twice the processor time, to draw
   * windows that are never shown.
   */
  static async start(base) {
    const executablePath = process.env.CHROMIUM ?? "/usr/bin/chromium-headless-shell";
    return new Browser(base, await chromium.launch({ executablePath, args: ARGUMENTS }));
  }

  constructor(base, chromium) {
    Object.assign(this, { base, chromium });
  }

  stop() {
    return this.chromium.close();
  }

  /** Pages opened from now on find that their user has chosen a table of jobs, not cards. */
  choosesTable() {
    const localStorage = [{ name: "fled list", value: "table" }];
    this.remembered = { cookies: [], origins: [{ origin: this.base, localStorage }] };
  }

  /**
   * Opens the page at `hash`, passes it to `judge(page, faults)` and fails if faults remain. Saves
   * the last state of a page that fails as `screenshots/NAME.png`.
   */
  async visit(name, hash, judge, viewport = DESKTOP, further = {}) {
    const context = await this.chromium.newContext({ viewport, acceptDownloads: true, storageState: this.remembered, ...further });
    context.setDefaultTimeout(PATIENCE);
    const page = await context.newPage();
    const faults = watch(page, this.base);
    if (process.env.WEB) await fromTree(page, this.base, process.env.WEB);
    if (this.isReady) await page.route("**/readyz", (route) => route.fulfill({ json: { ready: true, checks: [] } }));
    try {
      await page.goto(`${this.base}/${hash}`);
      await judge(page, faults);
      assert.deepEqual(faults, [], "faults of the page");
      await picture(page, name);
    } catch (error) {
      await screenshot(page, name);
      throw error;
    } finally {
      await context.close();
    }
  }
}

/** Saves a screenshot of a page: `screenshots/NAME.png`. */
export const screenshot = (page, name) => page.screenshot({ path: join(SCREENSHOTS, `${name}.png`), fullPage: true });

/** The same if SCREENSHOTS is set: pictures to look at, which take a tenth of the time. */
export async function picture(page, name) {
  if (process.env.SCREENSHOTS) await screenshot(page, name);
}

/** The faults of a page from now on, one per line. */
function watch(page, base) {
  const faults = [];
  const own = new URL(base).origin;
  page.on("console", (message) => {
    // Without a GPU, WebGL reads each frame back to show it, with a warning.
    if (message.text().includes("GL Driver Message (OpenGL, Performance")) return;
    if (["error", "warning"].includes(message.type())) {
      faults.push(`console: ${message.text()}`);
    }
  });
  page.on("pageerror", (error) => faults.push(`script: ${error.message}`));
  page.on("request", (request) => {
    const { protocol, origin } = new URL(request.url());
    if (protocol !== "data:" && origin !== own) faults.push(`outside: ${request.url()}`);
  });
  page.on("requestfailed", (request) => {
    const reason = request.failure()?.errorText;
    // The page itself aborted the request: it left, showed another picture, or its player asked
    // for another part of the file. Server and network failures have other reasons.
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

/** Serves the page's own files from a folder, so that changes need no build. */
async function fromTree(page, base, folder) {
  const own = (url) => url.origin === base && /^\/(assets\/.*)?$/.test(url.pathname);
  await page.route(own, (route) => {
    const { pathname } = new URL(route.request().url());
    const name = pathname.replace(/^\/(assets\/([0-9a-f]{16}\/)?)?/, "") || "index.html";
    return route.fulfill({ path: join(folder, name) });
  });
}

/** Elements beyond the right edge of the window that no element of their own scrolls. */
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

/** Reopens the page as a browser without WebGL. */
export async function withoutWebGl(page) {
  await page.addInitScript(() => {
    const real = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, ...further) {
      return kind === "webgl2" ? null : real.call(this, kind, ...further);
    };
  });
  await page.reload();
}

/** Whether every picture in `locator` has loaded. */
export async function loaded(locator) {
  const sizes = await locator.evaluateAll((images) => images.map((image) => image.naturalWidth));
  return sizes.length > 0 && sizes.every((size) => size > 0);
}

/** Share of a canvas's pixels that differ from its corner. */
export const drawn = (canvas) => canvas.evaluate((one) => {
  const copy = new OffscreenCanvas(one.width, one.height).getContext("2d");
  copy.drawImage(one, 0, 0);
  const { data } = copy.getImageData(0, 0, one.width, one.height);
  const differs = (at) => [0, 1, 2, 3].some((k) => Math.abs(data[at + k] - data[k]) > 24);
  let count = 0;
  for (let at = 0; at < data.length; at += 4) count += differs(at) ? 1 : 0;
  return (4 * count) / data.length;
});
