// Comparison of jobs: selecting them in a list, the page that compares them, and its address.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { duration } from "../../web/lib/dom.js";
import { loaded, picture } from "./browser.js";
import { Stand, both, button, part, provoked, seen } from "./played.js";
import { until } from "./until.js";

const HEADS = ["Job", "State", "Delivered round", "PSNR after colour fit, dB", "SSIM", "Photographs placed", "Time"];
const NOWHERE = "00000000-0000-7000-8000-000000000000";
const HOSTILE = "more <i>steps</i>";

let stand;
let server;

before(async () => {
  stand = await Stand.start();
  ({ server } = stand);
});

after(() => stand?.stop());

const made = new Map();

/** Submits a job of the finished job's capture with other options; returns its id. */
function another(name, options) {
  if (!made.has(name)) made.set(name, order(name, options));
  return made.get(name);
}

async function order(name, options) {
  const { capture_id, options: given } = await server.job(await stand.finished());
  const response = await fetch(`${server.base}/v1/jobs`, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({
      capture_id,
      name,
      preset: "preview",
      options: { ...given, ...options },
    }),
  });
  assert.ok(response.ok, await response.clone().text());
  return (await response.json()).id;
}

/** Two finished jobs of one capture; the second has three rounds and better scores. */
async function two() {
  const first = await stand.finished();
  const second = await another(HOSTILE, { steps: 60, rounds: 3 });
  await server.reached(second, "succeeded");
  return [first, second];
}

async function failed() {
  const id = await another("one that failed", { adapter: "few_poses" });
  await server.reached(id, "failed");
  return id;
}

/** Opens a comparison once its jobs have finished. */
const compare = (name, ids, judge, width, query = "", further = {}) =>
  stand.visit(
    name,
    `#/compare/${ids.join(",")}${query}`,
    async (page, faults) => {
      await page.getByRole("table", { name: "At a glance" }).locator("tbody tr").first().waitFor();
      await judge(page, faults);
    },
    width,
    further,
  );

const mark = (page, name) => page.getByRole("checkbox", { name: `Select ${name}`, exact: true });

both(
  "jobs selected in the list are compared, and the address names them",
  async (width) => {
    const [first, second] = await two();
    await stand.visit(
      "marked",
      "",
      async (page) => {
        const bar = page.getByRole("region", { name: "Selected jobs" });
        await mark(page, HOSTILE).waitFor();
        assert.equal(await bar.isVisible(), false);
        await mark(page, HOSTILE).focus();
        await page.keyboard.press("Space");
        await seen(bar, "1 job selected. Select another one to compare.");
        assert.equal(await bar.getByRole("link").isVisible(), false);
        await mark(page, "a finished <b>job</b>").check();
        await picture(page, `page-marked-${width}`);
        await bar.getByRole("link", { name: "Compare 2 jobs" }).click();
        await page.getByRole("heading", { name: "Compare 2 jobs" }).waitFor();
        assert.equal(new URL(page.url()).hash, `#/compare/${second},${first}`);
        // A reload would abort pending requests.
        const settled = () => loaded(page.getByRole("slider").locator("img"));
        await until("all is there", settled);
        await page.reload();
        await seen(page.locator("tbody tr"), HOSTILE);
        await until("all is there again", settled);
      },
      width,
    );
  },
);

both("differing options are shown and equal ones folded away", async (width) => {
  await compare(
    "differ",
    await two(),
    async (page) => {
      const options = part(page, "Options that differ");
      const rows = await options.locator("table tbody tr").allInnerTexts();
      assert.deepEqual(rows.map((text) => text.split(/\s/)[0]).sort(), ["Rounds", "Training"]);
      assert.match(
        rows.find((text) => text.startsWith("Training steps")),
        /40\s+60/,
      );
      const folded = options.locator("details");
      assert.equal(await folded.locator("dl").isVisible(), false);
      await folded.getByText(/identical option/).click();
      await seen(folded.locator("dt"), "Shake");
    },
    width,
  );
});

both("scores are listed by round and job, with the best of each round marked", async (width) => {
  await compare(
    "scores",
    await two(),
    async (page) => {
      const glance = page.getByRole("table", { name: "At a glance" });
      assert.match(await glance.locator("tbody tr").nth(0).innerText(), /20\.50(?!\s*best)/);
      assert.match(await glance.locator("tbody tr").nth(1).innerText(), /21\.50\s*best/);
      assert.deepEqual(
        (await glance.locator("thead th:not([hidden])").allInnerTexts()).map((one) => one.trim()),
        HEADS,
        "no column is empty",
      );
      const { started_at: from, finished_at: to } = await server.job(await stand.finished());
      await seen(glance.locator("tbody tr").nth(0), duration((Date.parse(to) - Date.parse(from)) / 1000));
      const metrics = part(page, "Metrics by round");
      assert.equal(await metrics.getByRole("table").count(), 0, "a chart replaces the table");
      await metrics.getByText("Values by round").first().click();
      const rows = metrics
        .getByRole("region", { name: "PSNR after colour fit, dB by round" })
        .locator("tbody tr");
      assert.deepEqual(
        (await rows.allInnerTexts()).map((text) => text.split(/\s+/).filter(Boolean)),
        [
          ["1", "19.50", "19.50"],
          ["2", "20.50", "20.50"],
          ["3", "21.50"],
        ],
      );
      await seen(metrics, "One decibel more means an error about a tenth smaller. Higher is better.");
      await metrics.getByText("Noise, time and size").click();
      await seen(metrics, "grain is left in the renders");
      const cut = await metrics.locator(".tick").evaluateAll((ticks) =>
        ticks.filter((one) => one.getBBox().x < 0).map((one) => one.textContent));
      assert.deepEqual(cut, [], "labels that are cut off");
      assert.equal(await metrics.getByText("with the photographs").count(), 0, "no agreement beside the truth");
      await metrics.getByLabel("Scored views").selectOption("train");
      await seen(rows.first(), "21.00");
      assert.equal(
        await metrics.locator("details.rest").evaluate((one) => one.open),
        true,
        "stays open",
      );
    },
    width,
  );
});

both("a chart's values are read by keyboard and by pointer", async (width) => {
  await compare(
    "chart",
    await two(),
    async (page) => {
      const plot = page.getByRole("group", {
        name: "PSNR after colour fit, dB: use the arrow keys to choose a round",
      });
      const legend = page.locator(".chart", { has: plot }).locator(".legend");
      await seen(
        legend,
        /Round 2:.*A, a finished <b>job<\/b> 20\.50.*B, more <i>steps<\/i> 20\.50/,
      );
      await plot.press("ArrowLeft");
      await seen(legend, /Round 1:.*19\.50/);
      await plot.press("End");
      await seen(legend, /Round 3:.*– .*21\.50|Round 3:.*–.*21\.50/);
      // Pictures still loading above move the chart; hovering waits until it rests.
      const { width: wide, height } = await plot.boundingBox();
      await plot.hover({ position: { x: wide * 0.15, y: height / 2 } });
      await seen(legend, "Round 1:");
      const styles = await plot
        .locator("path.line")
        .evaluateAll((lines) => lines.map((line) => getComputedStyle(line).stroke));
      assert.equal(new Set(styles).size, 2, "two colours");
      const shapes = await plot
        .locator("path.dot")
        .evaluateAll((dots) => dots.map((dot) => dot.getAttribute("d")));
      assert.equal(new Set(shapes).size, 2, "and two shapes");
    },
    width,
  );
});

both("one view of two jobs is shown side by side, as the address says", async (width) => {
  const [first, second] = await two();
  await compare(
    "beside",
    [first, second],
    async (page) => {
      const pictures = part(page, "The same view side by side");
      const slider = pictures.getByRole("slider");
      await until("both are there", () => loaded(slider.locator("img")));
      await seen(slider.locator(".left"), "A, a finished <b>job</b>, round 2");
      await seen(slider.locator(".right"), `B, ${HOSTILE}, round 3`);
      const cut = await slider.locator("span").evaluateAll((all) =>
        all.filter((one) => one.scrollWidth > one.clientWidth || one.scrollHeight > one.clientHeight).length);
      assert.equal(cut, 0, "no label is cut off");
      await pictures.getByLabel("view", { exact: true }).selectOption("003");
      await pictures.getByLabel("picture", { exact: true }).selectOption("deblurred");
      const sources = () =>
        slider
          .locator("img")
          .evaluateAll((images) => images.map((image) => new URL(image.src).pathname));
      assert.deepEqual(await sources(), [
        `/v1/jobs/${second}/artifacts/rounds/3/deblurred/003.jpg`,
        `/v1/jobs/${first}/artifacts/rounds/2/deblurred/003.jpg`,
      ]);
      await pictures.getByLabel("round", { exact: true }).selectOption("3");
      await seen(
        pictures,
        /A, a finished <b>job<\/b> has no picture “deblurred” for this view and round/,
      );
      assert.equal(await slider.isVisible(), false);
      await pictures.getByLabel("picture", { exact: true }).selectOption("inputs");
      await slider.waitFor();
      assert.equal(await pictures.getByLabel("round", { exact: true }).isVisible(), false);
      await pictures.getByLabel("right job").selectOption(first);
      await seen(pictures, "Both sides show the same job.");
      const { hash } = new URL(page.url());
      assert.match(hash, /\?left=A&right=A&view=003&picture=inputs&round=3$/);
      await page.reload();
      await slider.waitFor();
      assert.equal(await pictures.getByLabel("view", { exact: true }).inputValue(), "003");
      assert.equal(await pictures.getByLabel("picture", { exact: true }).inputValue(), "inputs");
      assert.equal(await pictures.getByLabel("right job").inputValue(), first);
      await until("both are there", () => loaded(slider.locator("img")));
    },
    width,
  );
});

both(
  "a missing, failed or running job is explained in a sentence beside the others",
  async (width) => {
    const [first] = await two();
    const runs = await another(`one that runs ${width}`, { adapter: "reconstruct:1500" });
    await server.when(runs, "trains", (job) => job.stage === "reconstruct");
    const ids = [first, await failed(), runs, NOWHERE];
    await compare(
      "partly",
      ids,
      async (page, faults) => {
        const rows = page.getByRole("table", { name: "At a glance" }).locator("tbody tr");
        await seen(
          rows.nth(1),
          "Failed: too few photographs could be placed. No round has finished.",
        );
        await seen(
          rows.nth(2),
          "Still running (round 1 of 2, reconstruct). No round has finished yet.",
        );
        await seen(rows.nth(3), "Job not found. It was deleted");
        await seen(part(page, "The same view side by side"), "has no pictures yet");
        await picture(page, `page-partly-${width}`);
        await page.getByRole("link", { name: /^Remove D, .* from the comparison$/ }).click();
        await page.getByRole("heading", { name: "Compare 3 jobs" }).waitFor();
        await seen(rows.nth(2), "one that runs");
        provoked(faults, 404);
        await server.cancel(runs);
        await seen(rows.nth(2), "Cancelled.");
      },
      width,
    );
  },
);

test("reused poses count no time, in a comparison or on the job's page", async () => {
  const ids = await two();
  await stand.visit("reused", `#/compare/${ids.join(",")}`, async (page) => {
    await page.route(`**/v1/jobs/${ids[1]}`, async (route) => {
      const response = await route.fetch();
      const job = await response.json();
      for (const stage of job.stages) if (stage.stage === "poses") stage.seconds = 107;
      await route.fulfill({ response, json: job });
    });
    await page.reload();
    const row = page.getByRole("region", { name: "Time by stage" }).locator("tr", { hasText: "poses" });
    await until("one of them is reused", async () =>
      /^poses[\d.]+ sreused$/.test((await row.textContent()) ?? ""));
    await page.goto(`${stand.server.base}/#/jobs/${ids[1]}`);
    await seen(page.locator(".bars"), "reused from an earlier job");
    assert.ok(!(await page.locator(".bars").textContent()).includes("1 min 47 s"));
  });
});

test("requests are repeated while the server does not answer", async () => {
  const ids = await two();
  await stand.visit("asked-again", `#/compare/${ids.join(",")}`, async (page, faults) => {
    const rows = page.getByRole("table", { name: "At a glance" }).locator("tbody tr");
    await rows.first().waitFor();
    await until("all is there", () => loaded(page.getByRole("slider").locator("img")));
    let isDown = true;
    await page.route(`**/v1/jobs/${ids[1]}/rounds`, (route) =>
      isDown
        ? route.fulfill({ status: 503, json: { detail: "The server is busy." } })
        : route.continue(),
    );
    await page.reload();
    await seen(rows.nth(1), "The server is busy.");
    isDown = false;
    await seen(rows.nth(1), "21.50");
    await until("all is there", () => loaded(page.getByRole("slider").locator("img")));
    provoked(faults, 503);
  });
});

test("an unreadable address gives a sentence", () =>
  stand.visit("unreadable", "#/compare/%,%E0%A4%A", async (page, faults) => {
    await seen(page.locator("tbody tr"), "Job not found");
    await until("both are asked for", () => faults.length === 4);
    provoked(faults, 404);
  }));

test("jobs of different captures are compared with a caution and without a best one", async () => {
  const [, second] = await two();
  const other = await server.submit(stand.folder, "of others", { adapter: "ok" });
  await server.reached(other, "succeeded");
  await compare("captures", [other, second], async (page) => {
    await seen(page.locator(".notices"), "These jobs use different captures");
    assert.equal(await page.locator(".best").count(), 0);
    await seen(part(page, "The same view side by side"), "may show different places");
  });
});

test("at least two and at most six jobs are compared", async () => {
  const [first, second] = await two();
  const more = [];
  for (let i = 0; i < 5; i++) more.push(await another(`number ${i}`, { steps: 50 + i }));
  await Promise.all(more.map((id) => server.reached(id, "succeeded")));
  await compare("six", [first, first, second, ...more], async (page) => {
    await page.getByRole("heading", { name: "Compare 6 jobs" }).waitFor();
    await seen(page.locator(".notices"), "The link names 1 more job");
    const strip = part(page, "The same view side by side").getByRole("group", {
      name: "pictures of the view",
    });
    await strip.scrollIntoViewIfNeeded();
    await until(
      "all six pictures are there",
      async () => (await strip.locator("img").count()) === 6 && loaded(strip.locator("img")),
    );
  });
  await stand.visit("one", `#/compare/${first},${first}`, async (page) => {
    await seen(page.getByRole("alert"), "Select two to six jobs");
  });
});

both("a job's page offers other jobs to compare with", async (width) => {
  const [first, second] = await two();
  await stand.visit(
    "compare-with",
    `#/jobs/${first}`,
    async (page) => {
      await button(page, "Compare with…").click();
      const dialog = page.getByRole("dialog");
      assert.equal(await button(dialog, "Compare").isDisabled(), true);
      await dialog.getByRole("checkbox", { name: HOSTILE }).check();
      await picture(page, `page-compare-with-${width}`);
      await button(dialog, "Compare").click();
      await page.getByRole("heading", { name: "Compare 2 jobs" }).waitFor();
      assert.equal(new URL(page.url()).hash, `#/compare/${first},${second}`);
      assert.equal(await page.getByRole("dialog").count(), 0);
    },
    width,
  );
});

both(
  "selected jobs are deleted after one question that names them; a running one stays",
  async (width) => {
    const names = [`old ${width}`, `<b>older</b> ${width}`];
    const ids = [];
    for (const name of names) ids.push(await another(name, { adapter: "few_poses" }));
    await Promise.all(ids.map((id) => server.reached(id, "failed")));
    const runs = await another(`busy ${width}`, { adapter: "reconstruct:1500" });
    await server.when(runs, "trains", (job) => job.stage === "reconstruct");
    const { capture_id: capture } = await server.job(runs);
    await stand.visit(
      "delete-marked",
      `#/captures/${capture}`,
      async (page) => {
        for (const name of [...names, `busy ${width}`]) await mark(page, name).check();
        const bar = page.getByRole("region", { name: "Selected jobs" });
        await button(bar, "Delete 3 jobs").click();
        const dialog = page.getByRole("dialog", { name: "Delete 2 jobs?" });
        for (const name of names) await seen(dialog, `“${name}”`);
        await seen(dialog, `“busy ${width}” is running and will be kept. Cancel it first.`);
        await picture(page, `page-delete-marked-${width}`);
        await page.keyboard.press("Escape");
        await dialog.waitFor({ state: "detached" });
        await server.job(ids[0]);
        await button(bar, "Delete 3 jobs").click();
        await button(dialog, "Delete 2 jobs").click();
        await mark(page, names[0]).waitFor({ state: "detached" });
        for (const id of ids) await assert.rejects(server.job(id), /404/);
        assert.equal(await mark(page, `busy ${width}`).isChecked(), true);
        await button(bar, "Clear selection").click();
        await bar.waitFor({ state: "hidden" });
      },
      width,
    );
    await server.cancel(runs);
  },
);
