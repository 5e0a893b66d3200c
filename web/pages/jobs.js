// A table of jobs.

import { duration, h, refill, when } from "../lib/dom.js";
import { selection } from "./selection.js";
import { doing, isOver, pill, presetOf, setBar, tagList, took } from "../lib/state.js";
import { row, table } from "../lib/table.js";
import { thumbs } from "./thumbs.js";
import { failed } from "../lib/words.js";

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
    presetOf(job),
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

/** The activity of a job, or its queue position; `known` are jobs with known positions. */
export function now(job, known) {
  if (job.state === "queued") return waits(job, known);
  const left =
    job.state === "running" && job.eta_seconds ? ` · ${duration(job.eta_seconds)} left` : "";
  return doing(job) + left;
}

/** Its position, and the job before it if the list knows it. */
function waits(job, known) {
  const place = doing(job);
  if (job.no_worker) return `${place}: ${job.no_worker.replaceAll("`", "")}`;
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
