// The workers, for sessions that may see everything: each one's hardware and activity.

import { Refusal, api, count, h, refill, when } from "../lib/dom.js";
import { seesAll } from "../lib/login.js";
import { doing, setBar } from "../lib/state.js";
import { row, table } from "../lib/table.js";
import { waitingList } from "./waiting.js";

/** @typedef {import("fled-api").Worker} Worker */
/** @typedef {import("fled-api").Job} Job */

const REFRESH_MS = 5000;
/** The API's largest page. */
const MOST = 200;

const COLUMNS = [
  { title: "Worker" },
  { title: "State" },
  { title: "Running", class: "runs" },
  { title: "Machine" },
  { title: "Last seen", class: "seen" },
];

/** Labels of the API's worker states. */
const LABELS = { works: "active", stops: "stopping", lost: "lost" };

const DENIED =
  "Only a token with the scope “admin” can see the workers. Ask the server's administrator for " +
  "one, then log out and log in with it.";
const NONE =
  "No worker has reported in the last 24 hours. For a single server this is normal: it runs every " +
  "job itself. If several machines share a database and a file store, no job runs until you start " +
  "a worker:";

/** @returns {Promise<import("fled-api").Workers>} */
const ask = () => api("v1/workers");

/** The page, refreshed every few seconds while visible. */
export function workersPage(main, who) {
  document.title = "Workers · fled";
  const gist = h("p", { class: "hint" });
  const versions = h("p", { class: "notices" });
  const why = h("div", { class: "hint", hidden: true });
  const problem = h("p", { class: "problem", role: "alert" });
  const list = workerTable();
  const waiting = waitingList();
  const parts = [h("h1", {}, "Workers"), gist, versions, why, list.root, problem];
  main.append(h("section", {}, parts), waiting.root);
  let [timer, gone, asks, asked] = [0, false, 0, ""];

  function without(...words) {
    for (const part of [gist, versions, list.root]) part.hidden = true;
    if (why.hidden) why.replaceChildren(...words);
    why.hidden = false;
  }

  function draw({ now, workers }, jobs) {
    asked = when(now);
    say(problem, "");
    if (workers.length === 0) {
      without(NONE, h("pre", {}, "fled worker --data DIR --db postgres://… --store s3://…"));
      return;
    }
    why.hidden = true;
    gist.hidden = false;
    say(gist, summary(workers));
    const differing = versionsOf(workers);
    versions.hidden = differing.size < 2;
    say(versions, versions.hidden ? "" : versionWords(differing));
    list.update(workers, { now: Date.parse(now), jobs, usual: usual(differing) });
  }

  async function refresh() {
    clearTimeout(timer);
    const mine = ++asks;
    const isOld = () => gone || mine !== asks;
    try {
      const [answer, running, queued] = await Promise.all([ask(), jobsOf("running"), jobsOf("queued")]);
      if (isOld()) return;
      draw(answer, new Map(running.jobs.map((job) => [job.id, job])));
      waiting.update(queued, answer.workers.length > 0);
    } catch (error) {
      if (isOld()) return;
      const words = error instanceof Refusal ? error.message : "The server is not responding.";
      say(problem, asked ? `${words}\nLast updated ${asked}.` : words);
    }
    if (!document.hidden) timer = setTimeout(refresh, REFRESH_MS);
  }
  /** Pauses while the page is hidden, and refreshes at once when it is shown. */
  function turn() {
    clearTimeout(timer);
    if (!document.hidden) refresh();
  }

  if (!seesAll(who)) {
    without(DENIED);
    return () => {};
  }
  document.addEventListener("visibilitychange", turn);
  refresh();
  return () => {
    gone = true;
    clearTimeout(timer);
    document.removeEventListener("visibilitychange", turn);
  };
}

/** @returns {Promise<import("fled-api").Jobs>} */
const jobsOf = (state) => api(`v1/jobs?state=${state}&limit=${MOST}`);

/** Sets text only if it changed, so that screen readers do not repeat it. */
function say(node, words) {
  if (node.textContent !== words) node.textContent = words;
}

/** The number of workers and their free capacity. */
function summary(workers) {
  const of = (state) => workers.filter((worker) => worker.state === state);
  const [working, stopping, lost] = ["works", "stops", "lost"].map(of);
  const states = [
    [working.length, LABELS.works],
    [stopping.length, LABELS.stops],
    [lost.length, LABELS.lost],
  ].filter(([number]) => Number(number) > 0);
  const [[, first]] = states;
  const all = count(workers.length, "worker");
  const stand = states.map(([number, label]) => `${number} ${label}`);
  const start = states.length > 1 ? `${all}: ${stand.join(", ")}` : `${all} ${first}`;
  const room = working.reduce((sum, one) => sum + Math.max(0, one.jobs - one.running.length), 0);
  const rest = room > 0 ? `room for ${room} more` : "no room for more";
  const runs = [...working, ...stopping].reduce((sum, one) => sum + one.running.length, 0);
  const run = runs === 0 ? "No jobs" : count(runs, "job");
  return `${start}. ${run} running, ${rest}.`;
}

/** Workers per version; lost ones do not count. */
function versionsOf(workers) {
  const counts = new Map();
  for (const { version, state } of workers) {
    if (state !== "lost") counts.set(version, (counts.get(version) ?? 0) + 1);
  }
  return counts;
}

const versionWords = (counts) =>
  `Workers run different versions: ${[...counts]
    .sort(([, a], [, b]) => b - a)
    .map(([version, number]) => `${version} on ${number}`)
    .join(", ")}.`;

/** The most common version; none for a tie or a single version. */
function usual(counts) {
  const [first, second] = [...counts].sort(([, a], [, b]) => b - a);
  return second && first[1] > second[1] ? first[0] : null;
}

/** A table of workers whose rows are kept, with focus, selection and scroll: `{ root, update }`. */
function workerTable() {
  const root = table(COLUMNS, [], { hidden: true });
  root.classList.add("workers");
  const [body] = root.tBodies;
  const rows = new Map();
  return {
    root,
    update(workers, known) {
      root.hidden = false;
      const sorted = workers.toSorted(
        (a, b) => a.host.localeCompare(b.host, "en", { numeric: true }) || (a.id < b.id ? -1 : 1),
      );
      for (const { id } of sorted) if (!rows.has(id)) rows.set(id, workerRow());
      const wanted = sorted.map(({ id }) => rows.get(id).root);
      const isOther = (one, i) => body.rows[i] !== one;
      if (body.rows.length !== wanted.length || wanted.some(isOther)) refill(body, wanted);
      for (const id of rows.keys()) if (!workers.some((one) => one.id === id)) rows.delete(id);
      for (const worker of sorted) rows.get(worker.id).update(worker, known);
    },
  };
}

function workerRow() {
  const cells = COLUMNS.map(() => h("div"));
  const shown = [];
  const root = row(COLUMNS, cells);
  /** Redraws a cell if its content changed. */
  const put = (i, nodes) => {
    const now = nodes.map((node) => node.outerHTML ?? node).join();
    if (shown[i] === now) return;
    shown[i] = now;
    refill(cells[i], nodes);
  };
  return {
    root,
    /** @param {Worker} worker */
    update(worker, known) {
      root.classList.toggle("idle", worker.running.length === 0);
      const drawn = [named, stands, runs, machine, heard];
      drawn.forEach((draw, i) => put(i, draw(worker, known)));
    },
  };
}

const small = (...content) => h("div", { class: "soft small" }, ...content);

/** @param {Worker} worker */
const named = ({ host, id }) => [h("strong", {}, host || "unnamed"), small(id)];

/** @param {Worker} worker */
function stands({ state, seen_at: seen, running }) {
  const words = {
    works: running.length > 0 ? "" : "waiting for a job",
    stops: "accepts no new jobs",
    lost: `last seen ${when(seen)}; its jobs go to other workers`,
  };
  const label = h("span", { class: `state ${state}` }, LABELS[state] ?? state);
  return words[state] ? [label, small(words[state])] : [label];
}

/** @param {Worker} worker */
function runs({ running, jobs: most, state }, { jobs }) {
  const all = running.map((one) => run(one, jobs.get(one.job_id)));
  if (all.length === 0) return ["no jobs"];
  const list = h("ul", { class: "bare" }, all.map((one) => h("li", {}, one)));
  return state === "works" && most > 1 ? [list, small(`${running.length} of ${most} at a time`)] : [list];
}

/**
 * @param {import("fled-api").Running} one
 * @param {Job | undefined} job `undefined` if it has just begun or ended.
 */
function run({ job_id: id, steps_per_second: speed }, job) {
  const name = job ? job.name || "unnamed" : `job ${id}`;
  const link = h("a", { href: `#/jobs/${id}` }, name);
  const words = [job && doing(job), speed && `${speed.toFixed(1)} steps/s`].filter(Boolean);
  if (!job) return [link, small(words.join(" · "))];
  const bar = h("progress", { max: 1, "aria-label": `Progress of ${name}` });
  setBar(bar, job);
  return [link, bar, small(words.join(" · "))];
}

const GIB = 2 ** 30;

/** @param {Worker} worker */
function machine({ adapter, has_gpu: hasGpu, cores, memory, version, state }, { usual }) {
  const drawer = hasGpu ? (adapter ?? "a GPU") : adapter ? `no GPU: ${adapter}` : "no GPU";
  const size = memory > 0 ? `${Number((memory / GIB).toFixed(1))} GiB` : "memory unknown";
  const differs = usual !== null && version !== usual && state !== "lost";
  const mark = differs && h("span", { class: "badge differs" }, "different");
  return [drawer, small(`${count(cores, "core")} · ${size}`), small(`version ${version}`, mark)];
}

/** @param {Worker} worker */
function heard({ seen_at: seen, started_at: started }, { now }) {
  const passed = (time) => age((now - Date.parse(time)) / 1000);
  const at = (time, words) => h("time", { dateTime: time, title: when(time) }, words);
  return [at(seen, `${passed(seen)} ago`), small("up for ", at(started, passed(started)))];
}

/** 75 -> "75 s", 7,500 -> "2 h": a single number, to be read at a glance. */
function age(seconds) {
  const units = [[86400, "days"], [3600, "h"], [60, "min"]];
  const [length, unit] = units.find(([length]) => seconds >= 2 * Number(length)) ?? [1, "s"];
  return `${Math.max(0, Math.floor(seconds / Number(length)))} ${unit}`;
}
