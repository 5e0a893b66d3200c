// The page of workers: access, the facts of each worker, and refreshing.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { Browser, picture } from "./browser.js";
import { change, machines, tell } from "./machines.js";
import { Stand, both, button, part, seen } from "./played.js";
import { Server } from "./server.js";
import { until } from "./until.js";

const HOST = "here <i>1</i>";
const ABOUT = {
  host: HOST,
  version: "0.9.0",
  adapter: null,
  has_gpu: false,
  cores: 8,
  memory: 16 * 2 ** 30,
  jobs: 2,
};
/** A tenth of a stage, ms. A job counts as dead after three seconds of silence. */
const SLOWLY = 1500;
/** The page refreshes every five seconds. */
const ROUND_MS = 5500;

let stand;
let server;

before(async () => {
  stand = await Stand.start({ FLED_FAKE_ABOUT: JSON.stringify(ABOUT) });
  ({ server } = stand);
  stand.browser.choosesTable();
});

after(() => stand?.stop());

/** A job left by a test, passed or failed, would delay the next one. */
afterEach(async () => {
  for (const state of ["queued", "running"]) {
    const { jobs } = await (await fetch(`${server.base}/v1/jobs?state=${state}`)).json();
    for (const { id } of jobs) await server.cancel(id);
    for (const { id } of jobs) await server.reached(id, "cancelled");
  }
});

/** The row of a worker. */
const row = (page, host) => page.locator(".workers tbody tr", { hasText: host });

const tab = (page) => page.getByRole("navigation").getByRole("link", { name: "Workers" });

/** Records a page's requests from now on whose address contains `what`. */
function questions(page, what) {
  const asked = [];
  page.on("request", (request) => {
    if (request.url().includes(what)) asked.push(request.url());
  });
  return asked;
}

/** Makes the page hidden or visible to its scripts. */
const hide = (page, isHidden) =>
  page.evaluate((hidden) => {
    Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
  }, isHidden);

async function busy(name) {
  const id = await stand.job(`reconstruct:${SLOWLY}`, name);
  await server.when(id, "trains", (job) => job.stage === "reconstruct" && job.steps_per_second);
  return id;
}

both("a worker shows its hardware and activity, and links to its jobs", async (width) => {
  const id = await busy(`busy <b>${width}</b>`);
  await stand.visit(
    "workers",
    "",
    async (page) => {
      await tab(page).click();
      const it = row(page, HOST);
      await it.waitFor();
      assert.equal(await tab(page).getAttribute("aria-current"), "page");
      for (const words of ["active", "no GPU", "8 cores · 16 GiB", "0.9.0", /\d s ago/, "up for"]) {
        await seen(it, words);
      }
      await seen(it, /round \d of 2, reconstruct · \d+\.\d steps\/s/);
      await seen(it, "1 of 2 at a time");
      await seen(page.locator("main"), "1 worker active. 1 job running, room for 1 more.");
      const times = await it.locator("time").evaluateAll((all) =>
        all.map((one) => [new Date(one.dateTime).toLocaleString(), one.title]),
      );
      assert.equal(times.length, 2);
      for (const [exact, title] of times) assert.equal(title, exact);
      await picture(page, `page-workers-${width}`);
      await it.getByRole("link", { name: `busy <b>${width}</b>` }).click();
      await page.waitForURL(`**/#/jobs/${id}`);
      await page.goBack();
      await seen(row(page, HOST), "busy");
    },
    width,
  );
});

test("an idle worker waits for a job, and no job waits", () =>
  stand.visit("workers-idle", "#/workers", async (page) => {
    await seen(row(page, HOST), "waiting for a job");
    await seen(row(page, HOST), "no jobs");
    await seen(part(page, "Waiting"), "No jobs are waiting.");
    assert.equal(await page.title(), "Workers · fled");
  }));

both("stopping, lost and differing workers are described in words", async (width) => {
  const id = await busy(`of three ${width}`);
  await stand.visit(
    "workers-states",
    "#/api",
    async (page) => {
      const answer = machines([id, "0199a3c4-0000-7000-8000-00000000aaaa"]);
      await tell(page, () => answer);
      await tab(page).click();
      const text = async (host) => (await row(page, host).innerText()).replace(/\s+/g, " ");
      await row(page, "plain").waitFor();
      assert.deepEqual(
        await page.locator(".workers strong").allTextContents(),
        ["gpu-2", "gpu-10", "old.rack-7.basement.example.org", "plain", "soft"],
      );
      await seen(page.getByText("5 workers:"), "3 active, 1 stopping, 1 lost. 2 jobs running, room for 4 more.");
      await seen(page.getByText("different versions"), "0.9.0 on 3, 0.10.0 on 1.");
      assert.match(await text("gpu-10"), /4 s ago up for 2 h/);
      assert.match(await text("gpu-10"), /job 0199a3c4-0000-7000-8000-00000000aaaa/);
      assert.match(await text("gpu-2"), /accepts no new jobs.* version 0\.10\.0 ?different/);
      assert.match(
        await text("old.rack"),
        /last seen .*; its jobs go to other workers.* version 0\.8\.1 30 min ago up for 3 days/,
      );
      assert.match(await text("plain"), /no GPU 1 core · memory unknown version 0\.9\.0 4 s/);
      assert.match(await text("soft"), /no GPU: llvmpipe .* 16 cores · 8 GiB version 0\.9\.0/);
      await picture(page, `page-workers-states-${width}`);
    },
    width,
  );
});

test("refreshing keeps focus, selection and scroll, and pauses while the page is hidden", async () => {
  const id = await busy("kept in sight");
  await stand.visit(
    "workers-fresh",
    "#/workers",
    async (page) => {
      let answer = machines([id]);
      await tell(page, () => answer);
      // The page's header also requests the workers, for its link.
      const asked = questions(page, "/v1/jobs?state=queued");
      const link = row(page, "gpu-10").getByRole("link");
      await link.focus();
      const at = await row(page, "soft").elementHandle();
      await page.evaluate(() => scrollTo(0, document.documentElement.scrollHeight));
      await page.evaluate((one) => getSelection().selectAllChildren(one), at);
      const place = () => page.evaluate((one) => [scrollY, one.getBoundingClientRect().top], at);
      const before = await place();
      assert.ok(before[0] > 0, "the page is long enough to be scrolled");
      answer = machines([id]);
      answer.workers[0].running[0].steps_per_second = 77.7;
      answer.workers[1].state = "works";
      await seen(row(page, "gpu-10"), "77.7 steps/s");
      await seen(row(page, "gpu-2"), "waiting for a job");
      assert.equal(await link.evaluate((one) => one === document.activeElement), true);
      assert.equal(await at.evaluate((one) => one.isConnected), true);
      assert.match(await page.evaluate(() => String(getSelection())), /soft/);
      assert.deepEqual(await place(), before);
      // A worker that leaves takes its row with it; the other rows stay.
      answer = { ...answer, workers: answer.workers.filter(({ host }) => host !== "plain") };
      await until("it is gone", async () => (await row(page, "plain").count()) === 0);
      assert.equal(await at.evaluate((one) => one.isConnected), true);
      await hide(page, true);
      const had = asked.length;
      await page.waitForTimeout(2 * ROUND_MS);
      assert.equal(asked.length, had, "a hidden page does not refresh");
      await hide(page, false);
      await until("it asks at once", () => asked.length === had + 1, 2000);
      await until("and again", () => asked.length === had + 2);
      await page.getByRole("link", { name: "API", exact: true }).click();
      await page.waitForTimeout(ROUND_MS);
      assert.equal(asked.length, had + 2, "the page is left");
    },
    "desktop",
    { viewport: { width: 1400, height: 480 } },
  );
});

test("errors are shown above the last data, and the page recovers by itself", () =>
  stand.visit("workers-away", "#/workers", async (page, faults) => {
    await row(page, HOST).waitFor();
    const alert = page.locator("main").getByRole("alert");
    const detail = "The database does not answer.";
    await page.route("**/v1/workers", (route) => route.fulfill({ status: 500, json: { detail } }));
    await seen(alert, detail);
    await seen(alert, "Last updated");
    assert.equal(await row(page, HOST).count(), 1);
    await page.unroute("**/v1/workers");
    await page.route("**/v1/workers", (route) => route.abort());
    await seen(alert, "The server is not responding.");
    await page.unroute("**/v1/workers");
    // An empty element is not an alert.
    await until("it is said no more", async () => (await alert.count()) === 0);
    // Answered with 500 or not at all.
    for (const fault of faults.splice(0)) assert.match(fault, /\b500\b|ERR_FAILED/);
  }));

both("jobs that need more than any worker say so on their page, in the list and among waiting jobs", async (width) => {
  const needs = "a worker with a GPU and 12 GiB of memory";
  await busy(`busy 1 ${width}`);
  await busy(`busy 2 ${width}`);
  const big = await server.submit(stand.folder, "a <u>big</u> one", { adapter: "ok" });
  await server.submit(stand.folder, "a small one", { adapter: "ok" });
  const needy = (job) => (job.id === big && job.state === "queued" ? { ...job, waits_for: needs } : job);
  await stand.visit(
    "workers-waits",
    "#/workers",
    async (page) => {
      await change(page, "**/v1/jobs?*", (list) => ({ ...list, jobs: list.jobs.map(needy) }));
      await change(page, `**/v1/jobs/${big}`, needy);
      const waiting = part(page, "Waiting");
      await seen(waiting.locator("li"), `1 job waiting for ${needs}: a <u>big</u> one`);
      await seen(waiting.locator("li"), "1 job waiting for any worker: a small one");
      await waiting.getByRole("link", { name: "a <u>big</u> one" }).click();
      await seen(page.locator("main"), `Waiting for ${needs}. Jobs that need less may start first.`);
      await picture(page, `page-needs-${width}`);
      await page.getByRole("link", { name: "View workers" }).click();
      await waiting.getByRole("link", { name: "All waiting jobs" }).click();
      const inList = (name) => page.locator(".jobs tbody tr", { hasText: name });
      await seen(inList("big"), `next in the queue: starts when ${needs} is free`);
      await seen(inList("a small one"), "position 2 in the queue, behind “a <u>big</u> one”");
      assert.equal(await inList("busy").count(), 0, "the list is filtered");
    },
    width,
  );
});

test("without workers no link leads to the page, and the page says why it is empty", async () => {
  const alone = await Stand.start();
  try {
    await alone.visit("workers-alone", "#/captures", async (page) => {
      await page.getByRole("heading", { level: 1 }).waitFor();
      await page.waitForLoadState("networkidle");
      assert.equal(await tab(page).count(), 0);
      await page.evaluate(() => { location.hash = "#/workers"; });
      await seen(page.locator("main"), "it runs every job itself");
      assert.equal(await page.locator("table:visible").count(), 0);
      await tell(page, () => machines());
      await seen(row(page, "soft"), "waiting for a job");
      assert.equal(await page.getByText("it runs every job itself").isVisible(), false);
    });
  } finally {
    await alone.stop();
  }
});

test("without the scope the page does not ask for workers, and names the scope", async () => {
  const locked = await Server.start(process.env.FLED);
  try {
    const [token, admin] = [locked.token("jobs:read"), locked.token()];
    const visitor = new Browser(locked.base, stand.browser.chromium);
    await visitor.visit("workers-denied", "#/workers", async (page) => {
      const asked = questions(page, "/v1/workers");
      await page.getByLabel("Token").fill(token);
      await button(page, "Log in").click();
      await seen(page.locator("main"), "Only a token with the scope “admin” can see the workers.");
      assert.equal(await tab(page).count(), 0);
      assert.deepEqual(asked, []);
      await tell(page, () => machines());
      await button(page, "Log out").click();
      await page.getByLabel("Token").fill(admin);
      await button(page, "Log in").click();
      await row(page, "soft").waitFor();
      await tab(page).waitFor();
    });
  } finally {
    await locked.stop();
  }
});
