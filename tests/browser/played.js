// Shared by the page tests: a server of played jobs, both widths, sections of a page.

import assert from "node:assert/strict";
import { cpSync } from "node:fs";
import { basename, join } from "node:path";
import { test } from "node:test";

import { Browser, overflowing } from "./browser.js";
import { Server } from "./server.js";
import { until } from "./until.js";

/** px */
export const WIDTHS = {
  phone: { width: 390, height: 844 },
  desktop: { width: 1400, height: 900 },
};
/** Size of the synthetic photographs. */
const SIZE = "240x160";

export class Stand {
  /** `further` is added to the server's environment. */
  static async start(further = {}) {
    const server = await Server.played(process.env.FLED, further);
    const browser = await Browser.start(server.base);
    // The played server reports a missing tool, which every page would count as a fault.
    browser.isReady = true;
    return new Stand(server, browser, server.spoilt(SIZE));
  }

  constructor(server, browser, folder) {
    Object.assign(this, { server, browser, folder, jobs: new Map() });
  }

  async stop() {
    await this.browser?.stop();
    await this.server?.stop();
  }

  /** A job of a plan, shared by several tests and submitted by the first; returns its id. */
  job(plan, name = plan) {
    const known = this.jobs.get(name) ?? this.server.submit(this.folder, name, { adapter: plan });
    this.jobs.set(name, known);
    return known;
  }

  /** The capture without its ground truth. */
  untrue() {
    const folder = join(this.server.folder, "untrue");
    const filter = (path) => !["gt", "HL"].includes(basename(path));
    cpSync(this.folder, folder, { recursive: true, filter });
    return folder;
  }

  /** A finished job of the capture without its ground truth. */
  async untold() {
    const id = await (this.untoldJob ??= this.server.submit(this.untrue(), "one without truth", { adapter: "ok" }));
    await this.server.reached(id, "succeeded");
    return id;
  }

  /** A played job that has succeeded. */
  async finished() {
    const id = await this.job("ok", "a finished <b>job</b>");
    await this.server.reached(id, "succeeded");
    return id;
  }

  /** Visits a page, which must also fit at the end. */
  visit(name, hash, judge, width = "desktop", further = {}) {
    const judged = async (page, faults) => {
      await judge(page, faults);
      await this.fits(page, width);
    };
    return this.browser.visit(`${name}-${width}`, hash, judged, WIDTHS[width], further);
  }

  /** Checks that nothing is wider than the page and no box empty. */
  async fits(page, width) {
    assert.deepEqual(await overflowing(page), [], `wider than ${WIDTHS[width].width} px`);
    assert.deepEqual(await emptyBoxes(page), [], "boxes with nothing but a title");
  }
}

/** Titles of the sections of a page that show nothing else. */
function emptyBoxes(page) {
  return page.locator("main section:visible").evaluateAll((boxes) => boxes
    .filter((box) => box.innerText.trim() === (box.querySelector("h2")?.innerText ?? "").trim())
    .map((box) => box.innerText));
}

/** Runs a test at both widths. */
export function both(name, judge) {
  for (const width of Object.keys(WIDTHS)) {
    test(`${name}, at ${WIDTHS[width].width} px`, () => judge(width));
  }
}

/** Waits for an element with the text. */
export const seen = (locator, text) => locator.filter({ hasText: text }).first().waitFor();

export const state = (page) => page.locator("h1 + .state");

export const button = (page, name) => page.getByRole("button", { name, exact: true });

/** The section of a page with a title. */
export function part(page, title) {
  const heading = page.getByRole("heading", { name: title, exact: true, level: 2 });
  return page.locator("section", { has: heading });
}

/** The same, unfolded if necessary. */
export async function opened(page, title) {
  const section = part(page, title);
  await section.waitFor();
  await section.locator("details").evaluate((one) => { one.open = true; });
  return section;
}

/** The chart with a title. */
export const chart = (root, title) => root.locator(".chart", { has: root.page().getByRole("heading", { name: title, level: 3 }) });

/** Opens the form that runs a finished job's photographs again; it must have its `steps`. */
export async function again(page, steps) {
  await page.getByRole("link", { name: "Run again with other options" }).click();
  const form = part(page, "Run again with other options");
  const field = form.getByLabel("Training steps", { exact: true });
  await until("the form has the job's options", async () => (await field.inputValue()) === steps);
  return form;
}

/** Plays a video until it has moved; returns the browser's facts about it. */
export async function plays(player) {
  await until("the player knows it", () => player.evaluate((one) => one.readyState >= 1));
  await player.evaluate((one) => { one.muted = true; return one.play(); });
  await until("it plays", () => player.evaluate((one) => one.currentTime > 0.5));
  return player.evaluate((one) => ({ error: one.error?.message, wide: one.videoWidth, seconds: one.duration }));
}

/** Checks that all faults are answers with this status, provoked by the test. */
export function provoked(faults, status) {
  for (const fault of faults.splice(0)) assert.match(fault, new RegExp(`\\b${status}\\b`));
}

/** Drops files, by name and text or bytes, on an element. */
export async function drop(page, selector, files) {
  const transfer = await page.evaluateHandle((list) => {
    const data = new DataTransfer();
    for (const [name, content] of list) data.items.add(new File([content], name, { type: "image/jpeg" }));
    return data;
  }, files);
  for (const event of ["dragover", "drop"]) {
    await page.dispatchEvent(selector, event, { dataTransfer: transfer });
  }
}
