// The dashboard from end to end: the real program, real jobs and a browser. `make test-browser`
// sets FLED to the path of the program; WEB=../../web serves the page from the tree instead of the
// program. Screenshots of pages that fail are saved to screenshots/; of all with SCREENSHOTS=1.

import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { Browser, PHONE, loaded, overflowing, withoutWebGl } from "./browser.js";
import { Server } from "./server.js";
import { until } from "./until.js";

// Contains markup, to detect a page that does not escape names.
const FINISHED = "a finished <b>job</b>";
const FAILED = "a failed job";
const RUNNING = "a running job";
const UPLOADED = "from the page";

/** Minutes of work, even on a GPU. */
const ENDLESS = { steps: 100_000 };

let server;
let browser;
let capture;

before(async () => {
  server = await Server.start(process.env.FLED);
  browser = await Browser.start(server.base);
  browser.choosesTable();
  capture = server.capture();
});

after(async () => {
  await browser?.stop();
  await server?.stop();
});

/** A job shared by several tests, submitted by the first; returns its id. */
function shared(name, options) {
  let id = null;
  return () => (id ??= server.submit(capture, name, options));
}

const finishing = shared(FINISHED, {});
const failing = shared(FAILED, { adapter: "no such adapter" });
const running = shared(RUNNING, ENDLESS);

async function finished() {
  await server.reached(await finishing(), "succeeded");
  return `#/jobs/${await finishing()}`;
}

async function failed() {
  await server.reached(await failing(), "failed");
  return `#/jobs/${await failing()}`;
}

/** A job's row in the list. */
const row = (page, name) => page.locator("tbody tr", { hasText: name });

/** The section of a job's page with a title. */
function part(page, title) {
  const heading = page.getByRole("heading", { name: title, exact: true, level: 2 });
  return page.locator("section", { has: heading });
}

const state = (page) => page.locator("h1 + .state");

const button = (page, name) => page.getByRole("button", { name });

/** Waits for an element with the text. */
const seen = (locator, text) => locator.filter({ hasText: text }).first().waitFor();

/** Waits until the progress read by `value` grows. */
async function grows(value) {
  const first = await value();
  await until("progress moves", async () => (await value()) > first);
  assert.ok((await value()) < 1);
}

const valueOf = (bar) => () => bar.evaluate((element) => element.value);

test("an empty list says how to begin, and the machine is ready", () =>
  browser.visit("list-empty", "", async (page) => {
    await page.getByText("No jobs yet.").waitFor();
    await until("the example is there", () => loaded(page.locator(".example img")));
    await seen(page.locator("#health"), /^Ready$/);
    assert.equal(await page.getByRole("table").isVisible(), false);
  }));

test("the sample runs with the preset and options of the form", async () => {
  let job;
  await browser.visit("sample", "", async (page) => {
    const form = part(page, "New job");
    const preset = form.getByLabel("Preset");
    assert.equal(await preset.inputValue(), "auto");
    for (const name of ["high", "paper"]) {
      const option = preset.locator(`[value=${name}]`);
      await until("it says what needs a GPU", async () => (await option.textContent()).includes("which this machine lacks"));
      assert.equal(await option.isDisabled(), true, name);
    }
    await preset.selectOption("preview");
    await button(page, "Try a sample").click();
    await page.waitForURL(/#\/jobs\//);
    await seen(page.getByRole("heading", { level: 1 }), "Sample: a dark room");
    job = await server.job(page.url().split("/").pop());
    assert.deepEqual([job.preset, job.state === "failed"], ["preview", false]);
    const { images } = await (await fetch(`${server.base}/v1/captures/${job.capture_id}`)).json();
    assert.deepEqual([images.length, images.every(({ accepted }) => accepted)], [16, true]);
    await button(page, "Cancel job").click();
    await button(page.getByRole("dialog"), "Cancel job").click();
    await seen(state(page), "cancelled");
  });
  // Only after the page is closed, as it may still request the job. The recorded one is beside it.
  const { jobs } = await (await fetch(`${server.base}/v1/jobs?capture_id=${job.capture_id}`)).json();
  assert.deepEqual(jobs.map(({ state }) => state), ["cancelled", "succeeded"]);
  for (const { id } of jobs) await fetch(`${server.base}/v1/jobs/${id}`, { method: "DELETE" });
  await fetch(`${server.base}/v1/captures/${job.capture_id}`, { method: "DELETE" });
});

test("nothing is sent until photographs are chosen", () =>
  browser.visit("upload-nothing", "", async (page) => {
    await button(page, "Start").click();
    await seen(page.getByRole("alert"), "Choose photographs");
  }));

test("a refused upload says why, and another can be tried", () =>
  browser.visit("upload-refused", "", async (page, faults) => {
    const path = join(server.folder, "notes.jpg");
    writeFileSync(path, "no photograph");
    await page.getByLabel("Choose files").setInputFiles(path);
    await button(page, "Start").click();
    await seen(page.getByRole("alert"), "notes.jpg");
    await until("the button can be pressed", () => button(page, "Start").isEnabled());
    // The refusal is answered once and reported once more by the browser itself.
    assert.equal(faults.length, 2);
    for (const fault of faults.splice(0)) assert.match(fault, /\b422\b/);
  }));

test("a chosen folder becomes a job, which is cancelled", () =>
  browser.visit("uploaded", "", async (page) => {
    await page.getByLabel("Choose a folder").setInputFiles(capture);
    await page.getByLabel("Name", { exact: true }).fill(UPLOADED);
    await part(page, "New job").getByLabel("Preset").selectOption("preview");
    await button(page, "Start").click();
    await seen(page.getByRole("heading", { level: 1 }), UPLOADED);
    const job = await server.job(page.url().split("/").pop());
    assert.deepEqual([job.name, job.preset], [UPLOADED, "preview"]);
    await seen(state(page), "running");
    await button(page, "Cancel job").click();
    await button(page.getByRole("dialog"), "Cancel job").click();
    await seen(state(page), "cancelled");
    assert.equal(await button(page, "Cancel job").count(), 0);
    await button(page, "Try again").waitFor();
  }));

test("a failed job shows the error with its hint, and fails again when retried", async () => {
  const address = await failed();
  const { error } = await server.job(await failing());
  assert.ok(error.detail && error.hint);
  await browser.visit("failed", address, async (page) => {
    await seen(state(page), "failed");
    const problem = page.locator(".problem:not(:empty)");
    assert.deepEqual(await problem.allInnerTexts(), [
      `${error.code.replaceAll("_", " ")}: ${error.detail}\n${error.hint}`,
    ]);
    await button(page, "Try again").click();
    await seen(page.locator("section"), "attempt 2");
    await seen(state(page), "failed");
    await seen(problem, error.hint);
  });
});

test("a job's page shows it finish, with scores and files", async () => {
  const id = await finishing();
  await browser.visit("finished", `#/jobs/${id}`, async (page) => {
    await seen(state(page), "succeeded");
    await seen(page.getByRole("heading", { level: 1 }), FINISHED);
    const metrics = part(page, "Metrics by round");
    await seen(metrics, "Against ground truth");
    const rows = metrics.getByRole("table").locator("tbody tr");
    await until("both rounds are in the table", async () => (await rows.count()) === 2);

    const { records } = (await server.rounds(id)).rounds[1];
    const score = records.find((record) => record.image === "render"
      && record.split === "held_out" && record.reference === "gt" && record.brightness === "final");
    const chart = metrics.getByRole("img", { name: "PSNR after colour fit, dB" });
    const label = `rendered, held out (2 views), round 2: ${score.psnr_cc_db.toFixed(2)}`;
    assert.equal(await chart.getByText(label, { exact: true }).count(), 1, label);

    await seen(part(page, "Time by stage"), "2 · reconstruct");
    await seen(part(page, "Details"), "8 of 8 photographs placed");
    const places = part(page, "Scores by view");
    assert.equal(await places.locator("tbody tr").count(), 8);
    const { fit } = (await server.rounds(id)).rounds[1].views[0];
    await seen(places.locator("tbody tr", { hasText: "000" }), fit.toFixed(2));
    await seen(part(page, "Files"), "scene.ply");
    await seen(part(page, "Log"), "round 2 is delivered");
  });
});

test("every picture of every view loads, and two can be compared", async () =>
  browser.visit("views", await finished(), async (page) => {
    const views = part(page, "Views");
    const choice = views.getByRole("combobox", { name: "view" });
    await views.waitFor();
    assert.equal(await choice.locator("option").count(), 8);
    const slider = views.getByRole("slider");
    const images = slider.locator("img");
    await until("both sides of the comparison are there", () => loaded(images));
    const before = await images.first().getAttribute("src");
    await choice.selectOption("003");
    assert.notEqual(await images.first().getAttribute("src"), before);
    await views.scrollIntoViewIfNeeded();
    await until("every picture of view 003 is there", () => loaded(views.locator("img")));

    const at = async () => Number(await slider.getAttribute("aria-valuenow"));
    assert.equal(await at(), 50);
    await slider.press("ArrowRight");
    assert.equal(await at(), 55);
    const box = await slider.boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width / 4, box.y + box.height / 2);
    await page.mouse.up();
    assert.ok(Math.abs((await at()) - 25) <= 1, `the bar is at ${await at()}`);

    await views.locator("figure", { hasText: "ground truth" }).click();
    await seen(slider.locator(".left"), "ground truth");
  }));

test("a novel view is rendered and turns", async () =>
  browser.visit("novel-view", await finished(), async (page) => {
    await withoutWebGl(page);
    const novel = part(page, "Novel view");
    const image = novel.getByRole("img", { name: "rendered view" });
    await seen(novel, "azimuth 0°");
    await until("a view is rendered", () => loaded(image));
    const before = await image.getAttribute("src");
    await novel.getByLabel("Novel view: use the arrow keys to turn").press("ArrowRight");
    await seen(novel, "azimuth 5°");
    assert.notEqual(await image.getAttribute("src"), before);
    await until("the turned view is there", () => loaded(image));

    const turned = await image.getAttribute("src");
    const answered = page.waitForResponse(/\/render\?.*\bround=1$/);
    await novel.getByRole("combobox", { name: "round" }).selectOption("1");
    assert.equal((await answered).status(), 200);
    await until("round 1 is shown", async () =>
      (await image.getAttribute("src")) !== turned && loaded(image));
  }));

test("a file of the result is downloaded", async () =>
  browser.visit("files", await finished(), async (page) => {
    const link = part(page, "Files").getByRole("link", { name: "metrics.json", exact: true });
    const [download] = await Promise.all([page.waitForEvent("download"), link.click()]);
    assert.equal(download.suggestedFilename(), "metrics.json");
    assert.equal(await download.failure(), null);
  }));

test("a running job shows its activity, and its progress moves without a reload", async () =>
  browser.visit("running", `#/jobs/${await running()}`, async (page) => {
    await seen(state(page), "running");
    await seen(page.locator("section"), /round 1 of 2, reconstruct · [0-9.]+ steps\/s · .* left/);
    await grows(valueOf(page.getByRole("progressbar", { name: "progress" })));
    await seen(part(page, "Time by stage"), "1 · enhance");
    await seen(part(page, "Log"), "round 1: reconstruct begins");
    assert.equal(await button(page, "Delete").count(), 0);
  }));

test("the list shows every job with its state and links to it", async () => {
  const states = [[FINISHED, "succeeded"], [FAILED, "failed"], [RUNNING, "running"]];
  await Promise.all([finished(), failed(), running()]);
  await browser.visit("list", "", async (page) => {
    for (const [name, word] of states) await seen(row(page, name).locator(".state"), word);
    const bar = (name) => row(page, name).getByRole("progressbar");
    assert.equal(await bar(FINISHED).count(), 0);
    await grows(valueOf(bar(RUNNING)));
    await page.getByRole("link", { name: FINISHED }).click();
    await seen(page.getByRole("heading", { level: 1 }), FINISHED);
    await page.getByRole("link", { name: "fled" }).click();
    await row(page, FINISHED).waitFor();
  });
});

test("the address of an unknown job says so", () =>
  browser.visit("unknown", "#/jobs/00000000-0000-7000-8000-000000000000", async (page, faults) => {
    await seen(page.getByRole("alert"), "Job not found.");
    for (const fault of faults.splice(0)) assert.match(fault, /\b404\b/);
  }));

test("nothing is wider than a phone", async () => {
  const pages = {
    list: "",
    finished: await finished(),
    failed: await failed(),
    running: `#/jobs/${await running()}`,
  };
  for (const [name, address] of Object.entries(pages)) {
    await browser.visit(`phone-${name}`, address, async (page) => {
      await (address ? state(page) : row(page, FINISHED)).waitFor();
      if (name === "finished") {
        await page.locator(".summary").waitFor();
        await part(page, "Files").waitFor();
      }
      assert.deepEqual(await overflowing(page), []);
    }, PHONE);
  }
});

test("a cancelled job runs again", async () =>
  browser.visit("again", `#/jobs/${await running()}`, async (page) => {
    await button(page, "Cancel job").click();
    await button(page.getByRole("dialog"), "Cancel job").click();
    await seen(state(page), "cancelled");
    await button(page, "Try again").click();
    await seen(state(page), "running");
    await seen(page.locator("section"), "attempt 2");
    // It would slow the tests that follow.
    await server.cancel(await running());
  }));

test("a deleted job leaves the list", async () => {
  await finished();
  await browser.visit("deleted", await failed(), async (page) => {
    await button(page, "Delete").click();
    await button(page, "Delete job").click();
    await row(page, FINISHED).waitFor();
    await until("its row is gone", async () => (await row(page, FAILED).count()) === 0);
  });
});

test("once a token exists the page asks for it, and forgets it on logout", async () => {
  const locked = await Server.start(process.env.FLED);
  try {
    const token = locked.token();
    const visitor = new Browser(locked.base, browser.chromium);
    await visitor.visit("login", "", async (page, faults) => {
      const enter = async (text) => {
        await page.getByLabel("Token").fill(text);
        await button(page, "Log in").click();
      };
      await seen(page.getByRole("heading", { level: 2 }), "This server requires a token");
      await enter("fled_of_somebody_else");
      await seen(page.getByRole("alert"), "unknown, revoked or");
      // The refusal is answered once and reported once more by the browser itself.
      assert.equal(faults.length, 2);
      for (const fault of faults.splice(0)) assert.match(fault, /\b401\b/);
      await enter(token);
      await page.getByText("No jobs yet.").waitFor();
      // A reload would cut the question off.
      await seen(page.locator("#health"), /^Ready$/);
      await page.reload();
      await page.getByText("No jobs yet.").waitFor();
      assert.equal(await page.evaluate("document.cookie"), "", "no script sees it");
      await button(page, "Log out").click();
      await page.getByLabel("Token").waitFor();
      await seen(page.locator("#health"), /^Ready$/);
      assert.deepEqual(await overflowing(page), []);
    }, PHONE);
  } finally {
    await locked.stop();
  }
});

test("a job that the server will delete says so, and can be kept", async () => {
  const tidy = await Server.start(process.env.FLED);
  try {
    const id = await tidy.sample();
    await tidy.restart(["--keep-jobs", "0"]);
    const visitor = new Browser(tidy.base, browser.chromium);
    await visitor.visit("kept", `#/jobs/${id}`, async (page) => {
      await page.getByText("This job will be deleted on").waitFor();
      await button(page, "Keep job").click();
      await page.getByText("Kept until you delete it").waitFor();
      assert.equal((await tidy.job(id)).pinned, true);
      assert.deepEqual(await overflowing(page), []);
      await button(page, "Allow deletion").click();
      await page.getByText("Kept until you delete it").waitFor({ state: "detached" });
      assert.equal((await tidy.job(id)).pinned, false);
    }, PHONE);
  } finally {
    await tidy.stop();
  }
});
