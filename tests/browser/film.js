// Films a page at a speed that a viewer can follow. Playwright's own recorder downloads an ffmpeg
// and runs in real time, so most of the film would be waits.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { join } from "node:path";

import { SCREENSHOTS, screenshot } from "./browser.js";

/** Frames per second. */
const RATE = 10;
/** Speed-up of waits. */
const FAST = 10;
/** Duration of a still, s. */
const STILL = 2;

export class Film {
  /** Starts filming the page: `screenshots/NAME.mp4`. */
  static async start(page, name) {
    const film = new Film(page, join(SCREENSHOTS, `${name}.mp4`));
    const size = page.viewportSize();
    // For a screenshot of the whole page the browser makes its window as high as the page.
    const onFrame = ({ data, viewportHeight }) => viewportHeight === size.height && film.#take(data);
    await page.screencast.start({ onFrame, size, quality: 90 });
    return film;
  }

  #last = null;
  #since = performance.now();
  #speed = 1;
  /** Length of the film, s, and frames written. */
  #length = 0;
  #written = 0;

  constructor(page, path) {
    this.page = page;
    this.path = path;
    const from = ["-f", "image2pipe", "-framerate", String(RATE), "-c:v", "mjpeg", "-i", "-"];
    // Odd sizes, and pixel formats that not every player reads, would be refused.
    const as = ["-vf", "crop=trunc(iw/2)*2:trunc(ih/2)*2,format=yuv420p", "-c:v", "libx264"];
    const options = ["-v", "error", "-y", ...from, ...as, "-preset", "veryfast", path];
    this.ffmpeg = spawn("ffmpeg", options, { stdio: ["pipe", "ignore", "inherit"] });
    this.ended = once(this.ffmpeg, "exit");
  }

  /** Writes the last frame for the time until now. */
  #advance(seconds) {
    this.#length += seconds;
    this.#since = performance.now();
    for (; this.#last && this.#written < this.#length * RATE; this.#written += 1) {
      this.ffmpeg.stdin.write(this.#last);
    }
  }

  #pass() {
    this.#advance((performance.now() - this.#since) / 1000 / this.#speed);
  }

  #take(shown) {
    this.#pass();
    this.#last = shown;
  }

  /** Waits; the film shows this faster. */
  async fast(wait) {
    this.#pass();
    this.#speed = FAST;
    try {
      return await wait();
    } finally {
      this.#pass();
      this.#speed = 1;
    }
  }

  /** Holds the current page for a while, and saves it as `screenshots/NAME.png`. */
  async still(name) {
    this.#take(await this.page.screenshot({ type: "jpeg", quality: 90 }));
    this.#advance(STILL);
    await screenshot(this.page, name);
  }

  /** Ends the film; returns its length in seconds. */
  async stop() {
    await this.page.screencast.stop();
    this.#pass();
    this.ffmpeg.stdin.end();
    const [code] = await this.ended;
    if (code !== 0) throw new Error(`ffmpeg ended with ${code}: there is no ${this.path}`);
    return this.#length;
  }
}
