// axe-core finds nothing serious on any page, light or dark, on a desktop or a phone.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";

import { Browser } from "./browser.js";
import { machines, tell, tellJobs } from "./machines.js";
import { Stand, button, part, provoked, seen, state } from "./played.js";
import { Server } from "./server.js";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const NOWHERE = "00000000-0000-7000-8000-000000000000";
const BAD = ["serious", "critical"];
/** A tenth of a stage, ms. */
const SLOWLY = 2500;

let stand;
let server;
let locked;

before(async () => {
  stand = await Stand.start();
  ({ server } = stand);
});

after(async () => {
  await locked?.stop();
  await stand?.stop();
});

/** The violations on a page, one per line. */
async function wrong(page) {
  // Unfolds everything to check it; text that fades in or moves has no final colour yet.
  await page.locator("details").evaluateAll((all) =>
    all.forEach((one) => {
      one.open = true;
    }),
  );
  await page.evaluate(AXE);
  const { violations } = await page.evaluate(() =>
    globalThis.axe.run(document, { resultTypes: ["violations"] }),
  );
  return violations
    .filter(({ impact }) => BAD.includes(impact))
    .flatMap(({ id, nodes }) =>
      nodes.map((node) => `${id}: ${node.html.slice(0, 160)} ${node.any[0]?.message ?? ""}`),
    );
}

async function ended(plan, name, as) {
  const id = await stand.job(plan, name);
  await server.reached(id, as);
  return id;
}

const failed = () => ended("few_poses", "a failed job", "failed");

async function running() {
  const [plan, name] = [`reconstruct:${SLOWLY}`, "one that runs"];
  // On a busy machine the checks before may take longer than the job.
  const known = stand.jobs.has(name) && (await server.job(await stand.job(plan, name)));
  if (known?.finished_at) stand.jobs.delete(name);
  const id = await stand.job(plan, name);
  await server.when(id, "trains", (job) => job.stage === "reconstruct" && job.steps_per_second);
  return id;
}

const PAGES = {
  list: [
    async () => (await stand.finished(), await failed(), await running(), "#/?q=o"),
    async (page) => {
      await page.getByRole("checkbox", { name: /^Select/ }).first().check();
      await page.getByRole("checkbox", { name: /^Select/ }).nth(1).check();
      await page.getByText("Options", { exact: true }).click();
      await page.locator(".option").first().waitFor();
      await page.locator(".pair img").first().waitFor();
    },
  ],
  finished: [
    async () => `#/jobs/${await stand.finished()}`,
    async (page) => {
      await page.locator(".summary").waitFor();
      await part(page, "Log").waitFor();
    },
  ],
  scene: [
    async () => `#/jobs/${await ended("splats", "one with a scene", "succeeded")}`,
    async (page) => {
      await page.getByRole("button", { name: /Walk through the scene/ }).click();
      await page.locator(".frame[aria-busy=false]").waitFor();
      await page.getByRole("combobox", { name: "Crop", exact: true }).selectOption("box");
      await page.getByRole("slider", { name: "Depth" }).waitFor();
      await page.getByRole("button", { name: "Measure" }).click();
      await seen(page.getByRole("status"), "Choose the first point");
    },
  ],
  failed: [async () => `#/jobs/${await failed()}`, (page) => seen(state(page), "failed")],
  running: [async () => `#/jobs/${await running()}`, (page) => seen(state(page), "running")],
  "compare-with": [
    async () => `#/jobs/${await stand.finished()}`,
    async (page) => {
      await button(page, "Compare with…").click();
      await page.getByRole("dialog").waitFor();
    },
  ],
  question: [
    async () => `#/jobs/${await stand.finished()}`,
    async (page) => {
      await button(page, "Delete").click();
      await page.getByRole("dialog").waitFor();
    },
  ],
  "list-table": [
    async () => (await stand.finished(), await failed(), "#/"),
    async (page) => {
      await button(page, "Table").click();
      await page.locator("tbody .pair img").first().waitFor();
    },
  ],
  captures: [
    async () => (await stand.finished(), "#/captures"),
    (page) => page.locator("tbody tr").first().waitFor(),
  ],
  capture: [
    async () => `#/captures/${(await server.job(await stand.finished())).capture_id}`,
    async (page) => {
      await part(page, "Jobs").locator("tbody tr").first().waitFor();
      await page.locator(".option").first().waitFor();
    },
  ],
  compare: [
    async () => {
      const others = [];
      for (let i = 0; i < 3; i++) others.push(await ended("ok", `another ${i}`, "succeeded"));
      const ids = [await stand.finished(), ...others, await failed(), NOWHERE];
      return `#/compare/${ids.join(",")}`;
    },
    async (page, faults) => {
      await page.getByRole("slider").waitFor();
      await seen(page.locator("tbody tr"), "Job not found");
      provoked(faults, 404);
    },
  ],
  workers: [
    () => "#/workers",
    async (page) => {
      const job = await server.job(await stand.finished());
      const runs = { ...job, state: "running", stage: "reconstruct", progress: 0.4 };
      const waits = { ...job, state: "queued", queue_position: 1, waits_for: "a worker with a GPU" };
      await tellJobs(page, { running: [runs], queued: [waits] });
      await tell(page, () => machines([job.id, NOWHERE]));
      await page.locator(".workers progress").waitFor();
      await seen(part(page, "Waiting"), "1 job waiting for a worker with a GPU");
    },
  ],
  api: [() => "#/api", (page) => page.locator("main details, main h2").first().waitFor()],
  nowhere: [() => "#/nowhere", (page) => page.getByRole("alert").waitFor()],
};

for (const [name, [address, shown]] of Object.entries(PAGES)) {
  test(`axe finds nothing serious on the page "${name}"`, async () => {
    const hash = await address();
    const judge = (width, schemes) => async (page, faults) => {
      await shown(page, faults);
      for (const colorScheme of schemes) {
        await page.emulateMedia({ colorScheme });
        assert.deepEqual(await wrong(page), [], `${width}, ${colorScheme}`);
      }
    };
    for (const [width, ...schemes] of [["desktop", "dark", "light"], ["phone", "light"]]) {
      await stand.visit(`axe-${name}`, hash, judge(width, schemes), width, { reducedMotion: "reduce" });
    }
  });
}

test("axe finds nothing serious on the login page", async () => {
  locked = await Server.start(process.env.FLED);
  locked.token();
  const visitor = new Browser(locked.base, stand.browser.chromium);
  await visitor.visit("axe-login", "", async (page) => {
    await page.getByLabel("Token").waitFor();
    await seen(page.locator("#health"), /^Ready$/);
    for (const colorScheme of ["dark", "light"]) {
      await page.emulateMedia({ colorScheme });
      assert.deepEqual(await wrong(page), [], colorScheme);
    }
  });
});

test("axe reports a violation that was planted", () =>
  stand.visit("axe-oracle", "#/captures", async (page) => {
    await page.getByRole("heading", { level: 1 }).waitFor();
    await page.locator("main").evaluate((main) => main.append(document.createElement("select")));
    assert.match((await wrong(page)).join(), /select-name/);
    await page.locator("main > select").evaluate((select) => select.remove());
  }));
