// The list of jobs, below the form that starts one.

import { api, count, duration, h, refill, when } from "../lib/dom.js";
import { asked, keep } from "../lib/place.js";
import { selection } from "./selection.js";
import { doing, isOver, pill, seconds, setBar, tagList, took } from "../lib/state.js";
import { row, table } from "../lib/table.js";
import { thumbs } from "./thumbs.js";
import { startForm } from "../upload/upload.js";
import { failed } from "../lib/words.js";

const REFRESH_MS = 1500;
/** Interval of requests for a long list. */
const MANY_MS = 6000;
/** The API's largest page. */
const MOST = 200;
/** Jobs shown at first, and added each time. */
const PAGE = 50;

const STATES = ["queued", "running", "succeeded", "failed", "cancelled"];
const PRESETS = ["preview", "standard", "paper"];

/** Orders of the list besides newest first. Scores against ground truth come first. */
const ORDERS = {
  score: (a, b) =>
    Number(b.score?.reference === "gt") - Number(a.score?.reference === "gt") ||
    (b.score?.psnr_cc_db ?? -1) - (a.score?.psnr_cc_db ?? -1),
  time: (a, b) => seconds(b) - seconds(a),
  name: (a, b) => a.name.localeCompare(b.name),
};

const COLUMNS = [
  { title: "Select", class: "pick", head: h("span", { class: "heard" }, "Select") },
  { title: "Picture", class: "pictured", head: h("span", { class: "heard" }, "Picture") },
  { title: "Name" },
  { title: "State" },
  { title: "Progress" },
  { title: "Details" },
  { title: "Time", class: "word" },
  { title: "Score", class: "word" },
  { title: "Preset", class: "word" },
  { title: "Created", class: "soft" },
];

/**
 * A table of jobs that is redrawn, with a bar for selected ones:
 * `{ root, update(jobs, known), leave }`; `known` are those with known queue positions.
 */
export function jobTable(refresh) {
  const list = table(COLUMNS, []);
  list.classList.add("jobs");
  const marked = selection(refresh);
  const pictures = thumbs();
  const root = h("div", { hidden: true }, list, marked.root);
  const body = list.tBodies[0];
  let shown = "";
  return {
    root,
    update(jobs, known = jobs) {
      const now = JSON.stringify([jobs, known.map((job) => job.queue_position)]);
      if (now === shown) return;
      shown = now;
      root.hidden = false;
      list.hidden = jobs.length === 0;
      refill(
        body,
        jobs.flatMap((job) => [
          row(COLUMNS, [marked.box(job), pictures.pairOf(job), ...cells(job, known)]),
          ...(job.error ? [reason(job.error)] : []),
        ]),
      );
      marked.update(jobs);
    },
    leave: () => pictures.leave(),
  };
}

function cells(job, known) {
  const bar = h("progress", { max: 1, "aria-label": "Progress" });
  setBar(bar, job);
  return [
    h("span", {}, h("a", { href: `#/jobs/${job.id}` }, job.name || "unnamed"), tagList(job)),
    pill(job),
    isOver(job) ? "" : bar,
    now(job, known),
    took(job),
    score(job),
    job.preset,
    when(job.created_at),
  ];
}

/**
 * Its score in decibels; a tip names the reference.
 * @param {import("fled-api").Job} job
 */
function score({ score: of }) {
  if (!of?.psnr_cc_db) return "";
  const other = of.reference === "gt" ? "ground truth" : "its photographs";
  const views = of.split === "held_out" ? "views that were held out" : "views that were trained on";
  const words = `Colour-fitted PSNR against ${other}, ${views}`;
  return h("span", { title: words }, `${of.psnr_cc_db.toFixed(1)} dB`);
}

/** Why a job failed, on a row of the list's full width below it. */
const reason = (error) =>
  h(
    "tr",
    { role: "row", class: "reason" },
    h(
      "td",
      { role: "cell", colSpan: COLUMNS.length },
      h("div", {}, h("b", {}, failed(error)), `: ${error.detail}`),
    ),
  );

/** The activity of a job, or its queue position. */
function now(job, known) {
  if (job.state === "queued") return waits(job, known);
  const left =
    job.state === "running" && job.eta_seconds ? ` · ${duration(job.eta_seconds)} left` : "";
  return doing(job) + left;
}

/** Its position, and the job before it if the list knows it. */
function waits(job, known) {
  const place = doing(job);
  if (job.queue_position === 1) {
    if (job.waits_for) return `${place}: starts when ${job.waits_for} is free`;
    const runs = known.some((other) => other.state === "running");
    return runs ? `${place}: starts when a running job finishes` : place;
  }
  const before = known.find(
    (other) => job.queue_position > 1 && other.queue_position === job.queue_position - 1,
  );
  const behind = before ? `${place}, behind “${before.name || "unnamed"}”` : place;
  return job.waits_for ? `${behind}; needs ${job.waits_for}` : behind;
}

/** The search: `{ root, values(), clear() }`; `changed(anew)` says whether to ask again. */
function filters(changed) {
  const wanted = asked();
  const search = h("input", {
    type: "search",
    placeholder: "Part of a name or tag",
    value: wanted.get("q") ?? "",
    maxLength: 200,
  });
  const choice = (words, all, name) =>
    h(
      "select",
      {},
      [["", all], ...words.map((word) => [word, word])].map(([value, text]) =>
        h("option", { value, selected: value === (wanted.get(name) ?? "") }, text),
      ),
    );
  const state = choice(STATES, "All states", "state");
  const preset = choice(PRESETS, "All presets", "preset");
  const sort = choice(Object.keys(ORDERS), "newest", "sort");
  const values = () => ({
    q: search.value.trim(),
    state: state.value,
    preset: preset.value,
    sort: sort.value,
  });
  const say = (anew) => {
    keep(values());
    changed(anew);
  };
  search.addEventListener("input", () => say(false));
  preset.addEventListener("change", () => say(false));
  sort.addEventListener("change", () => say(false));
  state.addEventListener("change", () => say(true));
  const field = (label, node) => h("label", {}, label, node);
  const root = h(
    "form",
    { class: "filters", role: "search", onsubmit: (event) => event.preventDefault() },
    field("Search", search),
    field("State", state),
    field("Preset", preset),
    field("Sort by", sort),
  );
  return {
    root,
    values,
    clear() {
      for (const one of [search, state, preset]) one.value = "";
      say(true);
      search.focus();
    },
  };
}

/** Reads pages of the API until there are `wanted` jobs: `{ jobs, isAll }`. */
async function pages(wanted, state) {
  const jobs = [];
  for (let cursor = ""; ;) {
    const query = new URLSearchParams({ limit: String(Math.min(MOST, wanted - jobs.length)) });
    if (state) query.set("state", state);
    if (cursor) query.set("cursor", cursor);
    /** @type {import("fled-api").Jobs} */
    const page = await api(`/v1/jobs?${query}`);
    jobs.push(...page.jobs);
    cursor = page.next_cursor;
    if (!cursor || jobs.length >= wanted) return { jobs, isAll: !cursor };
  }
}

/** The extent of the search, in a sentence. */
function searched(found, { jobs, isAll }, { q, state, preset }) {
  const of = `${state ? `${state} ` : ""}${jobs.length === 1 ? "job" : "jobs"}`;
  const all = isAll
    ? `${jobs.length.toLocaleString()} ${of}`
    : `the ${jobs.length.toLocaleString()} newest ${of}`;
  if (!q && !preset) return isAll ? `${all}.` : `Showing ${all}.`;
  const rest = isAll ? "" : " Older jobs were not searched.";
  const some = found === 0 ? "No" : found.toLocaleString();
  return `${some} ${found === 1 ? "match" : "matches"} among ${all}.${rest}`;
}

export function listPage(main) {
  // Loaded only if shown: a reload would fetch a hidden image, lazy or not.
  const example = h("img", { alt: "", width: 804, height: 225 });
  const jobs = jobTable(() => refresh());
  const empty = h(
    "div",
    { class: "example", hidden: true },
    h(
      "p",
      {},
      "No jobs yet. Start with a folder of 20 to 60 overlapping photographs of a place where " +
        "nothing moves.",
    ),
    h(
      "figure",
      {},
      example,
      h("figcaption", {}, "A dark, shaken photograph, and fled's scene from the same camera."),
    ),
  );
  const extent = h("span", { class: "hint", role: "status" });
  const more = h("button", { type: "button", hidden: true }, "Show older jobs");
  const every = h(
    "button",
    { type: "button", hidden: true, onclick: () => filter.clear() },
    "Show all jobs",
  );
  const problem = h("p", { class: "problem", role: "alert" });
  const form = startForm();
  const filter = filters((anew) => (anew ? refresh() : draw()));
  const list = h(
    "section",
    { hidden: true },
    h("h2", {}, "Jobs"),
    filter.root,
    problem,
    empty,
    h("p", { class: "row extent" }, extent, more, every),
    jobs.root,
  );
  main.append(form.root, list);
  let [wanted, timer, gone, asks, had] = [PAGE, 0, false, 0, { jobs: [], isAll: true }];
  more.addEventListener("click", () => {
    wanted += PAGE;
    refresh();
  });

  function draw() {
    const { q, state, preset, sort } = filter.values();
    const isFiltered = Boolean(q || state || preset);
    const shown = had.jobs.filter(
      (job) =>
        (!preset || job.preset === preset) &&
        [job.name || "unnamed", ...job.tags].some((word) => word.toLowerCase().includes(q.toLowerCase())),
    );
    if (sort in ORDERS) shown.sort(ORDERS[sort]);
    jobs.update(shown, had.jobs);
    form.known(had.jobs);
    list.hidden = false;
    const isNone = had.jobs.length === 0 && !isFiltered;
    empty.hidden = !isNone;
    if (isNone) example.src ||= new URL("../example.webp", import.meta.url).href;
    filter.root.hidden = isNone;
    extent.textContent = isNone ? "" : searched(shown.length, had, { q, state, preset });
    more.hidden = had.isAll;
    more.textContent = q || preset ? `Search ${count(PAGE, "older job")}` : "Show older jobs";
    every.hidden = !isFiltered;
  }

  async function refresh() {
    clearTimeout(timer);
    const mine = ++asks;
    try {
      const found = await pages(wanted, filter.values().state);
      // Ignore an answer that a later request has overtaken.
      if (gone || mine !== asks) return;
      had = found;
      draw();
      problem.textContent = "";
    } catch (error) {
      if (gone || mine !== asks) return;
      list.hidden = false;
      const rest = had.jobs.length > 0 ? "This list may be out of date." : "Jobs appear when it responds.";
      problem.textContent = `${error.message} ${rest}`;
    }
    if (!gone && mine === asks) timer = setTimeout(refresh, wanted > MOST ? MANY_MS : REFRESH_MS);
  }
  refresh();
  return () => {
    gone = true;
    clearTimeout(timer);
    form.leave();
    jobs.leave();
  };
}
