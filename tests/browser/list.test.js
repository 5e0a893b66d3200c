// The list of jobs: pictures, search, filters in the address, paging, and the queue.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { loaded, overflowing, picture } from "./browser.js";
import { Stand, both, button, seen } from "./played.js";
import { until } from "./until.js";

let stand;
let server;

before(async () => {
  stand = await Stand.start();
  ({ server } = stand);
  stand.browser.choosesTable();
  await server.reached(await stand.job("few_poses", "a failed (job)"), "failed");
  await stand.finished();
});

after(() => stand?.stop());

const names = (page) => page.locator("tbody tr a").allTextContents();

const shows = (page, wanted) =>
  until(
    `the list shows ${wanted}`,
    async () => JSON.stringify(await names(page)) === JSON.stringify(wanted),
  );

const FINISHED = "a finished <b>job</b>";
const FAILED = "a failed (job)";

both("a finished job shows a photograph before and after restoration", async (width) =>
  stand.visit(
    "thumbs",
    "",
    async (page) => {
      const pair = page.locator("tr", { hasText: FINISHED }).locator(".pair img");
      await until("both are there", async () => (await pair.count()) === 2 && loaded(pair));
      const sources = await pair.evaluateAll((images) =>
        images.map((one) => new URL(one.src).pathname),
      );
      assert.match(sources[0], /\/inputs\/000\.jpg$/);
      assert.match(sources[1], /\/rounds\/2\/renders\/000\.jpg$/);
      const only = page.locator("tr", { hasText: FAILED }).locator("img");
      await until("it has a photograph", async () => (await only.count()) === 1 && loaded(only));
      const first = await pair.first().elementHandle();
      await page.getByLabel("Search").fill("finished");
      await shows(page, [FINISHED]);
      assert.equal(
        await first.evaluate((node) => node.isConnected),
        true,
        "drawn again, not fetched again",
      );
    },
    width,
  ),
);

both("jobs are searched and filtered, and the address keeps the filters", async (width) =>
  stand.visit(
    "search",
    "",
    async (page) => {
      await shows(page, [FINISHED, FAILED]);
      await page.getByLabel("Search").fill("FAILED (");
      await shows(page, [FAILED]);
      await seen(page.getByRole("status"), "1 match among 2 jobs.");
      assert.equal(new URL(page.url()).hash, "#/?q=FAILED+%28");
      await page.getByLabel("State").selectOption("succeeded");
      await shows(page, []);
      await seen(page.getByRole("status"), "No matches among 1 succeeded job.");
      await picture(page, `page-search-${width}`);
      await button(page, "Show all jobs").click();
      await shows(page, [FINISHED, FAILED]);
      assert.equal(new URL(page.url()).hash, "#/");
      const presets = page.getByRole("search").getByLabel("Preset");
      await presets.selectOption("paper");
      await shows(page, []);
      await presets.selectOption("preview");
      await page.getByLabel("State").selectOption("failed");
      await shows(page, [FAILED]);
      // Going back restores the list.
      await page.getByRole("link", { name: FAILED }).click();
      await seen(page.locator("h1 + .state"), "failed");
      await page.goBack();
      await shows(page, [FAILED]);
      assert.equal(await page.getByLabel("State").inputValue(), "failed");
      assert.equal(new URL(page.url()).hash, "#/?state=failed&preset=preview");
      await page.getByRole("link", { name: "Jobs" }).click();
      await shows(page, [FINISHED, FAILED]);
    },
    width,
  ),
);

both("a failed job says why in a row of its own; a job that is over shows its time", (width) =>
  stand.visit(
    "failures",
    "",
    async (page) => {
      const row = page.locator("tr", { hasText: FAILED });
      await seen(
        row.locator("xpath=following-sibling::tr[1]"),
        "too few photographs could be placed: 3 of 20 photographs could be placed",
      );
      const done = page.locator("tr", { hasText: FINISHED });
      await seen(done.locator("td[data-label=Time]"), /^(\d+ min )?[\d.]+ s$/);
      assert.equal(await done.getByRole("progressbar").count(), 0);
    },
    width,
  ));

both("a job can be renamed and tagged, and is found by both", async (width) => {
  const id = await stand.job("few_poses", `to be named ${width}`);
  await server.reached(id, "failed");
  const word = `tag ${width}`;
  await stand.visit("tags", "", async (page) => {
    await page.getByLabel(`Select to be named ${width}`).check();
    await button(page, "Edit").click();
    const dialog = page.getByRole("dialog");
    await dialog.getByLabel("Name").fill(`named ${width}`);
    await dialog.getByLabel("Tags").fill(`night,  ${word}, night`);
    await picture(page, `page-tags-${width}`);
    await button(dialog, "Save").click();
    await dialog.waitFor({ state: "detached" });
    await page.getByLabel("Search").fill(word.toUpperCase());
    await shows(page, [`named ${width}`]);
    assert.deepEqual(await page.locator("tbody .tag").allTextContents(), ["night", word]);
    await page.getByRole("link", { name: `named ${width}` }).click();
    await seen(page.locator(".state + .tags"), word);
    await button(page, "Edit").click();
    await dialog.getByLabel("Tags").fill("");
    await page.keyboard.press("Enter");
    await until("the tags are gone", async () => (await page.locator(".tag").count()) === 0);
    assert.deepEqual((await server.job(id)).tags, []);
  }, width);
  await fetch(`${server.base}/v1/jobs/${id}`, { method: "DELETE" });
});

both("jobs are sorted by score, by time and by name, and the address keeps the order", async (width) =>
  stand.visit(
    "sorted",
    "",
    async (page) => {
      const rows = [
        ["by far", 29.5, "gt", 10],
        ["agrees", 40.25, "enhanced", 30],
        ["best", 30.5, "gt", 20],
        ["failed"],
      ];
      const { jobs: [one] } = await (await fetch(`${server.base}/v1/jobs?limit=1&state=failed`)).json();
      const jobs = rows.map(([name, psnr_cc_db, reference, took]) => ({
        ...one,
        id: name,
        name,
        error: undefined,
        started_at: took && "2026-01-02T03:04:00Z",
        finished_at: took && `2026-01-02T03:04:${took}Z`,
        score: psnr_cc_db && { psnr_cc_db, reference, split: "held_out" },
      }));
      await page.route("**/v1/jobs?*", (route) => route.fulfill({ json: { jobs } }));
      await shows(page, ["by far", "agrees", "best", "failed"]);
      const sort = page.getByLabel("Sort by");
      await sort.selectOption("score");
      await shows(page, ["best", "by far", "agrees", "failed"]);
      await seen(page.locator("tr", { hasText: "best" }).locator("td[data-label=Score]"), "30.5 dB");
      await sort.selectOption("time");
      await shows(page, ["agrees", "best", "by far", "failed"]);
      await sort.selectOption("name");
      await shows(page, ["agrees", "best", "by far", "failed"]);
      assert.equal(new URL(page.url()).hash, "#/?sort=name");
      await page.reload();
      await until("it is kept", async () => (await sort.inputValue()) === "name");
      assert.deepEqual(await overflowing(page), []);
    },
    width,
  ),
);

/** Serves made-up jobs, a page of the API at a time. */
async function many(page, number) {
  const {
    jobs: [one],
  } = await (await fetch(`${server.base}/v1/jobs?limit=1`)).json();
  const jobs = Array.from({ length: number }, (_, i) => ({
    ...one,
    id: `job-${i}`,
    name: `job ${i}`,
    state: "cancelled",
    stages: [],
    best_round: undefined,
  }));
  const asked = [];
  await page.route("**/v1/jobs?*", (route) => {
    const { searchParams: query } = new URL(route.request().url());
    asked.push(query.toString());
    const from = Number(query.get("cursor") ?? 0);
    const to = from + Number(query.get("limit"));
    return route.fulfill({
      json: { jobs: jobs.slice(from, to), next_cursor: to < number ? String(to) : null },
    });
  });
  return asked;
}

test("older jobs load page by page, and the list says how many it searched", () =>
  stand.visit("older", "#/captures", async (page) => {
    const asked = await many(page, 330);
    await page.getByRole("link", { name: "Jobs" }).click();
    await seen(page.getByRole("status"), "Showing the 50 newest jobs.");
    await page.getByLabel("Search").fill("job 77");
    await seen(
      page.getByRole("status"),
      "No matches among the 50 newest jobs. Older jobs were not searched.",
    );
    await button(page, "Search 50 older jobs").click();
    await shows(page, ["job 77"]);
    await seen(
      page.getByRole("status"),
      "1 match among the 100 newest jobs. Older jobs were not searched.",
    );
    await page.getByLabel("Search").fill("");
    for (let known = 150; known <= 250; known += 50) {
      await button(page, "Show older jobs").click();
      await seen(page.getByRole("status"), `the ${known} newest`);
    }
    assert.ok(asked.includes("limit=50&cursor=200"), asked.at(-1));
    await button(page, "Show older jobs").click();
    await seen(page.getByRole("status"), "the 300 newest");
    await button(page, "Show older jobs").click();
    await seen(page.getByRole("status"), "330 jobs.");
    assert.equal(await page.locator("tbody tr").count(), 330);
    assert.equal(await button(page, "Show older jobs").isVisible(), false);
  }));

both(
  "a waiting job says what it waits for, and its check box keeps the focus",
  async (width) => {
    const submit = (name, plan) => server.submit(stand.folder, name, { adapter: plan });
    const ids = [
      await submit("busy 1", "reconstruct:1500"),
      await submit("busy 2", "reconstruct:1500"),
      await submit("next one", "ok"),
      await submit("the last <i>one</i>", "ok"),
    ];
    await server.when(ids[1], "trains", (job) => job.stage === "reconstruct");
    await stand.visit(
      "waits",
      "",
      async (page) => {
        const row = (name) =>
          page.locator("tr", { has: page.getByRole("link", { name, exact: true }) });
        await seen(row("next one"), "next in the queue: starts when a running job finishes");
        await seen(row("the last <i>one</i>"), "position 2 in the queue, behind “next one”");
        const mark = page.getByRole("checkbox", { name: "Select next one" });
        await mark.focus();
        await page.keyboard.press("Space");
        const bar = () =>
          row("busy 1")
            .getByRole("progressbar")
            .evaluate((one) => one.value);
        const before = await bar();
        await until("the list is drawn again", async () => (await bar()) > before);
        assert.equal(await mark.isChecked(), true);
        assert.equal(await mark.evaluate((one) => one === document.activeElement), true);
        await page.getByLabel("Search").fill("busy");
        await seen(
          page.getByRole("region", { name: "Selected jobs" }),
          "None of them is shown in the list.",
        );
        await page.getByLabel("Search").fill("");
        await row("the last <i>one</i>").getByRole("link").click();
        const priority = page.getByLabel("Priority");
        const sent = [];
        page.on("request", (request) => request.method() === "PUT" && sent.push(request.postData()));
        await priority.fill("200");
        await priority.press("Enter");
        await priority.blur();
        await until("what cannot be goes", async () => (await priority.inputValue()) === "0");
        assert.deepEqual(sent, [], "it is not asked for");
        await priority.fill("5");
        await priority.press("Enter");
        await seen(page.locator("main"), "next in the queue, priority 5");
        assert.equal((await server.job(ids[3])).priority, 5);
        assert.deepEqual(sent, ['{"priority":5}']);
        assert.deepEqual(await overflowing(page), []);
        await picture(page, `page-priority-${width}`);
      },
      width,
    );
    for (const id of ids) await server.cancel(id);
    for (const id of ids) {
      await server.reached(id, "cancelled");
      await fetch(`${server.base}/v1/jobs/${id}`, { method: "DELETE" });
    }
  },
);

/** The page reports a lost server within this time, ms. */
const SOON = 5000;

both("a lost server is reported in the header and in the lists until it answers again", async (width) => {
  for (const [name, words] of [
    ["jobs", "Jobs appear when it responds."],
    ["captures", "Captures appear when it responds."],
  ]) {
    await stand.visit(
      `gone-${name}`,
      "#/api",
      async (page, faults) => {
        await seen(page.locator("#health"), "Ready");
        let isGone = true;
        await page.route(/\/(livez|readyz|v1\/.*|login)(\?|$)/, (route) =>
          isGone ? route.abort("connectionrefused") : route.fallback(),
        );
        await page.locator("#health", { hasText: "Server not responding" }).waitFor({ timeout: SOON });
        await page.getByRole("link", { name, exact: false }).first().click();
        await seen(page.getByRole("alert"), `The server is not responding. ${words}`);
        await picture(page, `page-gone-${name}-${width}`);
        isGone = false;
        await page.locator("tbody a").first().waitFor();
        await seen(page.locator("#health"), "Ready");
        await until("it says so no more", async () => (await page.getByText("not responding").count()) === 0);
        for (const fault of faults.splice(0)) assert.match(fault, /ERR_CONNECTION_REFUSED/);
      },
      width,
    );
  }
});
