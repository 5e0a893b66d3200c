// The list of jobs, below the form that starts one.

import { api, count, h } from "../lib/dom.js";
import { jobsIn } from "./layout.js";
import { asked, keep } from "../lib/place.js";
import { seconds } from "../lib/state.js";
import { startForm } from "../upload/upload.js";

const REFRESH_MS = 1500;
/** Interval of requests for a long list. */
const MANY_MS = 6000;
/** The API's largest page. */
const MOST = 200;
/** Jobs shown at first, and added each time. */
const PAGE = 50;

const STATES = ["queued", "running", "succeeded", "failed", "cancelled"];
const PRESETS = ["auto", "preview", "standard", "high", "paper"];

/** Orders of the list besides newest first. Scores against ground truth come first. */
const ORDERS = {
  score: (a, b) =>
    Number(b.score?.reference === "gt") - Number(a.score?.reference === "gt") ||
    (b.score?.psnr_cc_db ?? -1) - (a.score?.psnr_cc_db ?? -1),
  time: (a, b) => seconds(b) - seconds(a),
  name: (a, b) => a.name.localeCompare(b.name),
};

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
    keep({ ...values(), add: asked().get("add") });
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
    const page = await api(`v1/jobs?${query}`);
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
  const jobs = jobsIn(() => refresh());
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
    h("div", { class: "row extent" }, extent, more, every, jobs.choice),
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
    jobs.choice.hidden = isNone;
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
