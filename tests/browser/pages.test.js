// Every page in every state, at phone and desktop width, light and dark, by keyboard. The jobs are
// played: see `Server.played`. SCREENSHOTS=1 saves them to screenshots/.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { ticks } from "../../web/lib/chart.js";
import { loaded, picture } from "./browser.js";
import { Stand, both, button, drop, part, provoked, seen, state } from "./played.js";
import { until } from "./until.js";

const NOWHERE = "00000000-0000-7000-8000-000000000000";
/** A tenth of a stage, ms; a played job is stopped after 3 s of silence. */
const SLOWLY = 1500;
/** How much of a stage of 15 s may have passed, ms. */
const ENOUGH = 5_000;

let stand;
let server;

before(async () => {
  stand = await Stand.start();
  ({ server } = stand);
  stand.browser.choosesTable();
});

after(() => stand?.stop());

let queued = null;

/** A queue: both of the server's workers are busy for a while, and three jobs wait. */
async function queue() {
  queued = (await lasts(queued)) ? queued : await fill();
  return queued;
}

/** Whether a queue is unchanged and will last for a test; cancels its jobs otherwise. */
async function lasts(made) {
  if (!made) return false;
  const [poses, training] = await Promise.all(made.busy.map((id) => server.job(id)));
  if (poses.stage === "poses" && poses.state === "running" && training.stage === "reconstruct") {
    if (Date.now() - Date.parse(poses.stage_started_at) < ENOUGH) return true;
  }
  for (const id of [...made.busy, ...made.waiting]) await server.cancel(id).catch(() => {});
  return false;
}

async function fill() {
  const submit = (name, plan) => server.submit(stand.folder, name, { adapter: plan, pose_source: "auto" });
  const busy = [await submit("one that trains", `reconstruct:${SLOWLY}`), await submit("one that looks for poses", `poses:${SLOWLY}`)];
  const waiting = [];
  for (const name of ["first", "second", "third"]) waiting.push(await submit(`${name} in the queue`, "ok"));
  await server.when(busy[0], "trains", (job) => job.stage === "reconstruct" && job.eta_seconds);
  await server.when(busy[1], "finds poses", (job) => job.stage === "poses");
  return { busy: busy.reverse(), waiting };
}

async function failed() {
  const id = await stand.job("few_poses", "a failed job");
  await server.reached(id, "failed");
  return id;
}

async function cancelled() {
  const id = await stand.job(`enhance:${SLOWLY}`, "a cancelled job");
  await server.when(id, "runs", (job) => job.stage === "enhance");
  if ((await server.job(id)).state !== "cancelled") await server.cancel(id);
  await server.reached(id, "cancelled");
  return id;
}

const STATES = {
  finished: async () => `#/jobs/${await stand.finished()}`,
  failed: async () => `#/jobs/${await failed()}`,
  cancelled: async () => `#/jobs/${await cancelled()}`,
  captures: async () => (await stand.finished(), "#/captures"),
  capture: async () => `#/captures/${(await server.job(await stand.finished())).capture_id}`,
  poses: async () => `#/jobs/${(await queue()).busy[0]}`,
  training: async () => `#/jobs/${(await queue()).busy[1]}`,
  queued: async () => `#/jobs/${(await queue()).waiting[2]}`,
  list: async () => (await queue(), ""),
  "unknown-job": () => `#/jobs/${NOWHERE}`,
  "unknown-capture": () => `#/captures/${NOWHERE}`,
  "unknown-page": () => "#/nowhere",
};

/** Elements to wait for before the screenshot. */
const SHOWN = {
  finished: async (page) => {
    await page.locator(".summary").waitFor();
    await part(page, "Files").waitFor();
    // Folded content may also be too wide.
    await page.locator("details").evaluateAll((all) => all.forEach((one) => { one.open = true; }));
    // Pictures load when they come near.
    await page.locator(".shots").scrollIntoViewIfNeeded();
    await until("thumbnails are there", () => loaded(page.locator(".shots img")));
  },
  captures: (page) => page.locator("tbody tr").first().waitFor(),
  capture: (page) => part(page, "Jobs").locator("tbody tr").first().waitFor(),
  list: (page) => page.locator("tbody tr").first().waitFor(),
};

for (const name of Object.keys(STATES)) {
  both(`the page "${name}" fits, light and dark, and logs nothing to the console`, async (width) => {
    const address = await STATES[name]();
    await stand.visit(`page-${name}-light`, address, async (page, faults) => {
      const shown = SHOWN[name] ?? (() => page.locator("h1, [role=alert]").first().waitFor());
      await shown(page);
      if (name.startsWith("unknown-") && name !== "unknown-page") provoked(faults, 404);
      await stand.fits(page, width);
      await picture(page, `page-${name}-dark-${width}`);
      await page.emulateMedia({ colorScheme: "light" });
    }, width, { colorScheme: "dark" });
  });
}

both("a waiting job shows its position in the queue", async (width) => {
  const { waiting } = await queue();
  await stand.visit("queued", `#/jobs/${waiting[1]}`, async (page) => {
    await seen(state(page), "queued");
    const { queue_position: place } = await server.job(waiting[1]);
    await seen(page.locator(".now"), place === 1 ? "next in the queue" : `position ${place} in the queue`);
    assert.equal((await server.job(waiting[2])).queue_position, place + 1);
  }, width);
});

both("the search for poses shows its time so far, and no share", async (width) => {
  const { busy } = await queue();
  assert.ok((await server.job(busy[0])).stage_started_at);
  await stand.visit("poses", `#/jobs/${busy[0]}`, async (page) => {
    await seen(page.locator(".now"), /poses · (\d+ of 10 photographs and pairs matched · )?\d:\d\d so far; usually one to two minutes/);
    await seen(page.locator(".now"), /poses · \d+ of 10 photographs and pairs matched · /);
    const small = part(page, "Photographs").locator(".photographs img");
    await until("the photographs are there", async () => (await small.count()) === 8 && loaded(small));
    const line = await page.locator(".now").textContent();
    await until("the time goes on", async () => (await page.locator(".now").textContent()) !== line);
    const bar = page.getByRole("progressbar", { name: "progress" });
    assert.equal(await bar.getAttribute("value"), null);
  }, width);
});

both("a job in training shows its speed, the time left and the time of the stage", async (width) => {
  const { busy } = await queue();
  await stand.visit("training", `#/jobs/${busy[1]}`, async (page) => {
    await seen(page.locator(".now"), /reconstruct · 25\.0 steps\/s · .* left · \d:\d\d in this stage/);
  }, width);
});

both("a job's page lists the photographs left out, with the reason", async (width) =>
  stand.visit("left-out", `#/jobs/${await stand.finished()}`, async (page) => {
    await seen(part(page, "Photographs"), "8 of 9 photographs used");
    await seen(part(page, "Photographs").locator("li"), /^broken\.jpg: .+/);
    await page.getByRole("link", { name: "View photographs" }).click();
    await seen(part(page, "Photographs").locator("tbody tr").first(), /broken\.jpg.*not used: /);
    assert.equal(await part(page, "Photographs").locator("tbody tr").count(), 9);
  }, width));

test("a page whose modules fail to load says so, and appears once they load", () =>
  stand.visit("no-modules", "#/", async (page, faults) => {
    await part(page, "New job").waitFor();
    let isGone = true;
    await page.route("**/pages/captures.js", (route) => (isGone ? route.abort() : route.continue()));
    await page.goto(`${server.base}/?anew#/captures`);
    await seen(page.getByRole("alert"), "The server did not send this page.");
    isGone = false;
    await page.reload();
    await page.getByRole("heading", { name: "Captures", level: 1 }).waitFor();
    faults.length = 0;
  }));

both("unknown addresses give a sentence with a link back, and no empty box", async (width) => {
  for (const [hash, words, link] of [
    [`#/jobs/${NOWHERE}`, "Job not found.", "All jobs"],
    ["#/jobs/nonsense", "Job not found.", "All jobs"],
    [`#/captures/${NOWHERE}`, "Capture not found.", "All captures"],
    ["#/nowhere", "Page not found.", "All jobs"],
  ]) {
    await stand.visit("unknown", hash, async (page, faults) => {
      await seen(page.getByRole("alert"), words);
      assert.equal(await page.locator("main section").count(), 1);
      await page.getByRole("link", { name: link }).click();
      await page.locator("main h1, main form").first().waitFor();
      provoked(faults, 404);
    }, width);
  }
});

both("deleting and cancelling a job ask first, and can be declined", async (width) => {
  const id = await server.submit(stand.folder, `to be deleted ${width}`, { adapter: `poses:${SLOWLY}` });
  await stand.visit("dialogs", `#/jobs/${id}`, async (page) => {
    const dialog = page.getByRole("dialog");
    await button(page, "Cancel job").focus();
    await page.keyboard.press("Enter");
    await seen(dialog, "Cancel this job?");
    await page.keyboard.press("Escape");
    await dialog.waitFor({ state: "detached" });
    assert.notEqual((await server.job(id)).state, "cancelled");
    assert.equal(await button(page, "Cancel job").evaluate((one) => one === document.activeElement), true);
    await button(page, "Cancel job").click();
    await button(dialog, "Cancel job").click();
    await seen(state(page), "cancelled");

    await button(page, "Delete").click();
    await seen(dialog, "The photographs are kept");
    // The safe answer has the focus.
    await page.keyboard.press("Enter");
    await dialog.waitFor({ state: "detached" });
    assert.equal((await server.job(id)).state, "cancelled");
    await button(page, "Delete").click();
    await picture(page, `page-dialog-${width}`);
    await button(page, "Delete job").click();
    await part(page, "Jobs").waitFor();
    await assert.rejects(server.job(id), /404/);
  }, width);
});

both("a failed job says what happened and what to do, once each", async (width) => {
  const id = await failed();
  const { error } = await server.job(id);
  await stand.visit("failed", `#/jobs/${id}`, async (page) => {
    await seen(state(page), "failed");
    const text = await page.locator("main > section").first().innerText();
    for (const words of [error.detail, error.hint]) assert.equal(text.split(words).length, 2, words);
  }, width);
});

both("a failure is explained in a sentence, on the page and in the list", async (width) => {
  await stand.visit("explained", `#/jobs/${await failed()}`, async (page) => {
    await seen(page.locator(".advice"), "fled could not work out where enough of the photographs were taken.");
    // Newer jobs may have moved it off the first page.
    await page.goto(`${server.base}/#/?state=failed`);
    await seen(page.locator("tr:has-text('a failed job') + .reason"), "too few photographs could be placed");
  }, width);
  await stand.visit("explained", `#/jobs/${await stand.finished()}`, async (page) => {
    await seen(state(page), "succeeded");
    assert.equal(await page.locator(".advice").isVisible(), false);
  }, width);
});

both("the meaning of scores can be read beside them, by keyboard and by touch", async (width) =>
  stand.visit("meanings", `#/jobs/${await stand.finished()}`, async (page) => {
    const metrics = part(page, "Metrics by round");
    const [truth, other] = [0, 1].map((i) => metrics.locator("details.meanings").nth(i));
    await truth.locator("summary").focus();
    await page.keyboard.press("Enter");
    await seen(truth.locator("dd"), /colours match \(psnr_cc\)\. .* Higher is better\./);
    await seen(truth.locator("dd"), "blur that PSNR forgives");
    await metrics.locator("details.fold").first().evaluate((one) => { one.open = true; });
    await other.locator("summary").tap();
    await seen(other.locator("dd"), "grain is left in the renders");
  }, width, { hasTouch: true }));

both("options are a list and can all be read", async (width) =>
  stand.visit("options", `#/jobs/${await stand.finished()}`, async (page) => {
    const facts = part(page, "Details");
    await facts.waitFor();
    await facts.locator("details").first().evaluate((one) => { one.open = true; });
    await facts.getByText(/^All \d+ options$/).focus();
    await page.keyboard.press("Enter");
    const { options } = await server.job(await stand.finished());
    const names = facts.locator("details details dt");
    assert.equal(await names.count(), Object.keys(options).length);
    await seen(names, "Camera poses");
  }, width));

test("a single word stays on one line in the list", async () => {
  await stand.finished();
  // A phone's compact list leaves the preset out.
  await stand.visit("badge", "", async (page) => {
    const cell = page.locator("tbody td", { hasText: /^preview$/ }).first().locator("div");
    const lines = await cell.evaluate((node) => {
      const range = document.createRange();
      range.selectNodeContents(node);
      return new Set([...range.getClientRects()].map((box) => Math.round(box.top))).size;
    });
    assert.equal(lines, 1);
  });
});

test("the labels of a chart's grid differ, however close its values are", () => {
  for (const [low, high] of [[0.4701, 0.4722], [0, 1], [20.1, 20.11], [3, 3000], [0.99, 1]]) {
    const labels = ticks(low, high).map(([, label]) => label);
    assert.ok(labels.length >= 2 && labels.length <= 6, labels.join());
    assert.equal(new Set(labels).size, labels.length, labels.join());
  }
});

both("the charts of a finished job repeat no label", async (width) =>
  stand.visit("charts", `#/jobs/${await stand.finished()}`, async (page) => {
    const charts = part(page, "Metrics by round").locator("svg");
    await charts.first().waitFor();
    for (const svg of await charts.all()) {
      const labels = await svg.locator(".tick").allTextContents();
      assert.ok(labels.length >= 2);
      assert.equal(new Set(labels).size, labels.length, labels.join());
    }
  }, width));

both("dropped files can be removed one by one by keyboard", async (width) =>
  stand.visit("dropped", "", async (page) => {
    await drop(page, ".drop", [["a.jpg", "a"], ["b.jpg", "b"], ["c.jpg", "c"]]);
    await page.getByText("3 files chosen").waitFor();
    await button(page, "Remove b.jpg").focus();
    await page.keyboard.press("Enter");
    await page.getByText("2 files chosen").waitFor();
    await page.keyboard.press("Enter");
    await page.getByText("1 file chosen").waitFor();
    assert.deepEqual(await page.locator(".files .path").allTextContents(), ["a.jpg"]);
    await picture(page, `page-dropped-${width}`);
    await button(page, "Remove all").click();
    await page.getByText("Options", { exact: true }).click();
    await page.getByLabel("Training steps", { exact: true }).fill("0");
    await button(page, "Start").click();
    await seen(page.getByRole("alert"), "Choose photographs");
    await seen(page.getByRole("alert"), "Training steps: enter a whole number");
  }, width));

both("a drop beside the box counts, and on another page leaves the page open", async (width) => {
  await stand.visit("beside", "", async (page) => {
    // The header appears before the page listens.
    await page.getByLabel("Name", { exact: true }).waitFor();
    await drop(page, "header", [["a.jpg", "a"]]);
    await page.getByText("1 file chosen").waitFor();
  }, width);
  await stand.visit("beside", "#/captures", async (page) => {
    const refused = await page.evaluate(() => {
      const data = new DataTransfer();
      data.items.add(new File(["a"], "a.jpg"));
      return ["dragover", "drop"].map((name) => {
        const event = new DragEvent(name, { dataTransfer: data, bubbles: true, cancelable: true });
        document.body.dispatchEvent(event);
        return event.defaultPrevented;
      });
    });
    assert.deepEqual(refused, [true, true]);
  }, width);
});

test("a job of the preset auto shows what its machine chose, and why", async () => {
  const name = "left to the machine";
  const id = await stand.server.submit(stand.folder, name, { adapter: "ok" }, "auto");
  await stand.server.reached(id, "succeeded");
  await stand.visit("auto", `#/jobs/${id}`, (page) =>
    seen(page.locator("p.hint"), "auto: standard (a fake device is not a GPU) · created"));
  await stand.visit("auto-list", "", (page) =>
    page.locator("tr", { hasText: name }).getByText("auto: standard").waitFor());
});
