// Compares two to six jobs, named in the address.

import { beside } from "./beside.js";
import { count, duration, folding, h, nothing, prose, refill, section, show } from "../lib/dom.js";
import { differences, sorted } from "./differences.js";
import {
  called,
  entry,
  isDone,
  look,
  nameOf,
  named,
  note,
  tag,
} from "./entries.js";
import { MOST_COMPARED, comparisonOf } from "../lib/place.js";
import { best, cell, points, scores } from "./scores.js";
import { pill, reusedPoses, setBar, took } from "../lib/state.js";
import { row, table } from "../lib/table.js";
import { METRICS, optionName } from "../lib/words.js";

const REFRESH_MS = 3000;
/** Options that change which pictures the scores compare. */
const OTHER_PICTURES = ["size", "held_out"];

export function comparePage(main, list) {
  const { ids, left } = named(list);
  document.title = "Compare · fled";
  if (ids.length < 2) {
    nothing(main, "Select two to six jobs in the list to compare them.");
    return () => {};
  }
  const entries = ids.map(entry);
  const head = h("section", {}, h("h1", {}, `Compare ${count(ids.length, "job")}`));
  const notices = h("ul", { class: "plain notices" });
  const glance = overview(entries);
  const options = section("Options that differ");
  const metrics = scores();
  const pictures = beside();
  const times = folding("Time by stage");
  const warnings = section("Warnings");
  head.append(glance.root, notices);
  main.append(
    head,
    options,
    pictures.root,
    metrics.root,
    h("div", { class: "columns" }, times, warnings),
  );
  let [timer, gone, drawn] = [0, false, ""];

  function draw() {
    const words = cautions(entries);
    if (left > 0)
      words.unshift(`The link names ${count(left, "more job")}; only ${MOST_COMPARED} can be compared.`);
    notices.replaceChildren(...words.map((text) => h("li", {}, text)));
    notices.hidden = words.length === 0;
    const isFair = isOneCapture(scored(entries));
    glance.update(isFair);
    // Progress does not change these, so a chart being read is not redrawn.
    const results = JSON.stringify(entries.map((one) => [one.seen, one.isGone]));
    if (results === drawn) return;
    drawn = results;
    show(options, differences(entries));
    metrics.update(entries, isFair);
    pictures.update(entries);
    show(times, timeTable(entries));
    show(warnings, warningList(entries));
  }

  async function refresh() {
    clearTimeout(timer);
    const changes = await Promise.all(entries.filter((one) => !isDone(one)).map(look));
    if (gone) return;
    if (changes.some(Boolean)) draw();
    if (entries.some((one) => !isDone(one))) timer = setTimeout(refresh, REFRESH_MS);
  }
  refresh();
  return () => {
    gone = true;
    clearTimeout(timer);
  };
}

const isOneCapture = (entries) =>
  new Set(entries.filter((one) => one.job).map((one) => one.job.capture_id)).size < 2;

const scored = (entries) => entries.filter((one) => one.rounds.length > 0);

/** Reasons to be careful with a comparison. */
function cautions(entries) {
  const words = [];
  if (!isOneCapture(entries)) {
    words.push(
      isOneCapture(scored(entries))
        ? "These jobs use different captures."
        : "These jobs use different captures: their scores are for different photographs, so none " +
            "is marked as the best.",
    );
  }
  const there = entries.filter((one) => one.job).map((one) => one.job);
  const other =
    there.length < 2 ? [] : sorted(there).differing.filter((name) => OTHER_PICTURES.includes(name));
  if (other.length > 0) {
    words.push(
      `These jobs differ in ${other.map((key) => optionName(key).toLowerCase()).join(" and ")}: ` +
        "their scores are for different pictures, and small differences mean nothing.",
    );
  }
  return words;
}

const COLUMNS = [
  { title: "Job" },
  { title: "State" },
  { title: "Delivered round" },
  { title: "PSNR after colour fit, dB", class: "figure" },
  { title: "SSIM", class: "figure" },
  { title: "Agreement, dB", class: "figure" },
  { title: "Photographs placed" },
  { title: "Time", class: "figure" },
  { title: "Note", class: "note" },
];

/** The most important facts, a row per job: `{ root, update(isFair) }`. */
function overview(entries) {
  const root = table(COLUMNS, [], { "aria-label": "At a glance" });
  root.classList.add("glance");
  const caption = h("p", { class: "hint" });
  const drop = entries.length > 2;

  function update(isFair) {
    const split = entries.some(
      (one) =>
        points(one, "own_psnr", { split: "held_out" }).length > 0 ||
        points(one, "psnr_cc", { image: "render", split: "held_out" }).length > 0,
    )
      ? "held_out"
      : "train";
    const value = (one, key) => {
      const all = points(one, key, { image: "render", split });
      const wanted = one.report?.best_round;
      return (all.find(([round]) => round === wanted) ?? all.at(-1))?.[1];
    };
    const marked = ["psnr_cc", "ssim", "own_psnr"].map((key) => {
      const isBest =
        isFair && key !== "own_psnr"
          ? best(
              entries.map((one) => value(one, key)),
              METRICS[key],
            )
          : () => false;
      return (one) => cell(value(one, key), METRICS[key], isBest(value(one, key)));
    });
    refill(
      root.tBodies[0],
      entries.map((one) =>
        row(COLUMNS, [
          who(one, entries, drop),
          one.job ? stateOf(one.job) : "",
          delivered(one),
          ...marked.map((score) => score(one)),
          placed(one.report),
          one.job ? took(one.job) : "",
          note(one),
        ]),
      ),
    );
    // A value that no job has would make an empty column.
    COLUMNS.forEach((_, i) => {
      const cells = [...root.tBodies[0].rows].map((one) => one.cells[i]);
      for (const one of [root.tHead.rows[0].cells[i], ...cells])
        one.hidden = cells.every((cell) => cell.classList.contains("empty"));
    });
    const views = split === "held_out" ? "held-out" : "training";
    caption.textContent =
      `Scores are means over the renders of the ${views} views in the delivered round, ` +
      "or in the latest if none is delivered.";
    caption.hidden = entries.every((one) => one.rounds.length === 0);
  }
  return { root: h("div", {}, root, caption), update };
}

function who(one, entries, drop) {
  const name = one.job
    ? h("a", { href: `#/jobs/${one.id}` }, nameOf(one))
    : h("span", { class: "soft" }, nameOf(one));
  const others = entries.filter((other) => other !== one).map((other) => other.id);
  const out = h(
    "a",
    {
      href: comparisonOf(others),
      class: "out",
      title: "Remove from the comparison",
      "aria-label": `Remove ${called(one)} from the comparison`,
    },
    "×",
  );
  return h("span", { class: "who" }, tag(one), " ", name, " ", drop && out);
}

function stateOf(job) {
  if (job.state !== "running") return pill(job);
  const bar = h("progress", { max: 1, "aria-label": "Progress" });
  setBar(bar, job);
  return h("div", {}, pill(job), bar);
}

const delivered = ({ report, rounds, job }) =>
  rounds.length === 0
    ? ""
    : report.best_round
      ? `${report.best_round} of ${job.rounds}`
      : `none yet; ${rounds.length} of ${job.rounds} finished`;

const placed = (report) =>
  report?.registered === undefined ? "" : `${report.registered} of ${report.views}`;

/** Seconds per stage, summed over all rounds. */
function timeTable(entries) {
  const there = entries.filter((one) => one.job?.stages.length > 0);
  if (there.length === 0) return null;
  const stages = [...new Set(there.flatMap((one) => one.job.stages.map((stage) => stage.stage)))];
  const of = (one, name) =>
    one.job.stages
      .filter((stage) => stage.stage === name)
      .reduce((sum, stage) => sum + stage.seconds, 0);
  const line = (title, value) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, title),
      there.map((one) => h("td", { class: "number" }, value(one))),
    );
  const titles = there.map((one) => h("th", { scope: "col", class: "number" }, tag(one)));
  const times = h(
    "table",
    { class: "narrow" },
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Stage"), titles)),
    h(
      "tbody",
      {},
      stages.map((name) =>
        line(name, (one) =>
          name === "poses" && reusedPoses(one.job) ? "reused" : duration(of(one, name)),
        ),
      ),
    ),
  );
  return Object.assign(
    h(
      "div",
      { class: "scroll", tabIndex: 0, role: "region", "aria-label": "Time by stage" },
      times,
    ),
    { gist: count(stages.length, "stage") },
  );
}

/** Each warning once, with the jobs that have it. */
function warningList(entries) {
  const found = new Map();
  for (const one of entries) {
    for (const warning of one.job?.warnings ?? []) {
      found.set(warning.message, [...(found.get(warning.message) ?? []), one]);
    }
  }
  if (found.size === 0) return null;
  return h(
    "ul",
    { class: "bare" },
    [...found].map(([text, of]) => h("li", {}, of.map(tag), " ", prose(text))),
  );
}
