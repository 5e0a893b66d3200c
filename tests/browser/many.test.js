// Machines that share a database, as the dashboard shows them: one joins, one dies.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { picture } from "./browser.js";
import { Stand, part, seen } from "./played.js";
import { Postgres } from "./postgres.js";
import { fake } from "./server.js";
import { until } from "./until.js";

const GIB = 2 ** 30;
const NEEDS = "a worker with a GPU and 12 GiB of memory";
/** A tenth of a stage, ms; a job starts again on another machine. */
const SLOWLY = 1500;

let postgres;
let folder;
let shared;
let stand;
const workers = [];

before(async () => {
  postgres = await Postgres.start();
  folder = mkdtempSync(join(tmpdir(), "fled-many-"));
  shared = { FLED_FAKE_DB: postgres.address, FLED_FAKE_STORE: join(folder, "store") };
  stand = await Stand.start({ ...shared, FLED_FAKE_WORKERS: "0" });
});

after(async () => {
  for (const worker of workers) worker.kill("SIGKILL");
  await stand?.stop();
  await postgres?.stop();
  rmSync(folder, { recursive: true, force: true });
});

/** Starts a worker that reports `further` about itself. */
function work(host, further) {
  const machine = { adapter: null, has_gpu: false, cores: 4, memory: 16 * GIB, jobs: 2 };
  const about = JSON.stringify({ host, version: "0.9.0", ...machine, ...further });
  const env = { ...process.env, ...shared, FLED_FAKE_WORKER: "1", FLED_FAKE_ABOUT: about };
  const places = [join(folder, host), join(folder, `${host}.address`)];
  const child = spawn(fake(process.env.FLED), ["serve", ...places], { env, stdio: "ignore" });
  workers.push(child);
  return child;
}

const submit = (name, preset) =>
  stand.server.submit(stand.folder, name, { adapter: `reconstruct:${SLOWLY}` }, preset);

test("a worker joins, takes the job waiting for it and dies, and the job moves to the other", () =>
  stand.visit("many", "#/workers", async (page) => {
    const { server } = stand;
    const row = (host) => page.locator(".workers tbody tr", { hasText: host });
    await seen(page.locator("main"), "No worker has reported in the last 24 hours.");
    const big = await submit("a big one", "paper");
    const waiting = part(page, "Waiting");
    await seen(waiting.locator("li"), `1 job waiting for ${NEEDS}: a big one`);
    const weak = work("weak");
    await seen(row("weak"), "waiting for a job");
    await waiting.getByRole("link", { name: "a big one" }).click();
    await seen(page.locator("main"), "No connected worker has a GPU and 12 GiB of memory. Start fled worker");
    await page.getByRole("link", { name: "View workers" }).click();
    const small = await submit("a small one", "preview");
    await seen(row("weak"), "a small one");
    await seen(row("weak"), /reconstruct · \d+\.\d steps\/s/);
    assert.equal((await server.job(big)).state, "queued");
    work("strong", { adapter: "a card", has_gpu: true });
    await seen(row("strong"), "a big one");
    await seen(waiting, "No jobs are waiting.");
    await seen(page.getByText("2 workers active."), "2 jobs running, room for 2 more.");
    weak.kill("SIGKILL");
    await seen(row("weak"), /lost\s*last seen .*; its jobs go to other workers/);
    await seen(row("strong"), "a small one");
    await until("it has none any more", async () => (await row("weak").getByRole("link").count()) === 0);
    await seen(page.getByText("2 workers:"), "1 active, 1 lost. 2 jobs running, no room for more.");
    await picture(page, "page-many");
    for (const id of [small, big]) await server.cancel(id);
    for (const id of [small, big]) await server.reached(id, "cancelled");
    await seen(row("strong"), "waiting for a job");
    // A worker that is asked to stop says so, ends, and leaves nothing behind.
    workers.at(-1).kill("SIGINT");
    await until("it is gone", async () => (await row("strong").count()) === 0);
    await seen(page.locator("main"), "1 worker lost. No jobs running, no room for more.");
    await page.reload();
    await page.getByRole("navigation").getByRole("link", { name: "Workers" }).waitFor();
    await row("weak").waitFor();
  }));
