// Scores of several jobs: a curve per job, and a table by round with the best score marked.

import { chart } from "../lib/chart.js";
import { h, plain } from "../lib/dom.js";
import { called, tag } from "./entries.js";
import { agreement, hasTruth, recordOf } from "../job/records.js";
import { METRICS, direction } from "../lib/words.js";

const IMAGES = [
  ["render", "renders"],
  ["deblurred", "deblurred views"],
  ["enhanced", "enhanced views"],
];
const SPLITS = ["held_out", "train"];

/** Scores of renders without ground truth. */
const own = (round, of) =>
  hasTruth([round]) ? undefined : recordOf(round, { ...of, image: "render" }, false);

/** How to find each score in a round; `of` selects the pictures. */
const VALUES = {
  psnr_cc: (round, of) => recordOf(round, of, true)?.psnr_cc_db,
  ssim: (round, of) => recordOf(round, of, true)?.ssim,
  own_psnr: (round, of) => own(round, of) && (agreement(round) ?? own(round, of).psnr_cc_db),
  own_ssim: (round, of) => own(round, of)?.ssim,
  noise: (round) => round.noise_sigma?.render ?? round.noise_sigma?.renders,
  seconds: (round) => round.seconds,
  gaussians: (round) => round.gaussians,
};
/** Shown first; the rest is folded away. */
const FIRST = ["psnr_cc", "ssim", "own_psnr", "own_ssim"];
/** Scores that mark no best job: self-agreement, and grain, which may go with the detail. */
const UNJUDGED = ["own_psnr", "own_ssim", "noise"];

/** `[[round, value], ...]` of a score, without the rounds that lack it. */
export const points = (entry, key, of) =>
  entry.rounds
    .map((round) => [round.round, VALUES[key](round, of)])
    .filter(([, value]) => Number.isFinite(value));

/** Finds the best of several values; ties are all best, but none is if all are equal. */
export function best(values, metric) {
  const real = values.filter(Number.isFinite);
  const written = (value) => value.toFixed(metric.digits);
  if (!metric.better || new Set(real.map(written)).size < 2) return () => false;
  const wanted = metric.better === "higher" ? Math.max(...real) : Math.min(...real);
  return (value) => Number.isFinite(value) && written(value) === written(wanted);
}

/** A formatted value, marked if it is the best. */
export function cell(value, metric, isBest) {
  if (!Number.isFinite(value)) return "";
  const text =
    metric.digits > 0 ? value.toFixed(metric.digits) : Math.round(value).toLocaleString();
  return isBest ? h("span", { class: "best" }, text, h("span", { class: "badge" }, "best")) : text;
}

/** `{ root, update(entries, isFair) }`; marks no best value unless `isFair`. */
export function scores() {
  const choice = (label, options) =>
    h(
      "select",
      { "aria-label": label, onchange: draw },
      options.map(([value, text]) => h("option", { value }, text)),
    );
  const image = choice("Scored pictures", IMAGES);
  const split = choice(
    "Scored views",
    SPLITS.map((name) => [name, name === "train" ? "training" : plain(name)]),
  );
  const body = h("div");
  const root = h(
    "section",
    { hidden: true },
    h(
      "div",
      { class: "row" },
      h("h2", {}, "Metrics by round"),
      h(
        "span",
        { class: "row push" },
        h("label", {}, "Pictures", image),
        h("label", {}, "Views", split),
      ),
    ),
    body,
  );
  /** Scores whose values are unfolded; redrawing keeps them so. */
  const opened = new Set();
  let [entries, isFair, begun] = [[], true, false];

  function draw() {
    const of = { image: image.value, split: split.value };
    const blocks = Object.keys(METRICS).map((key) => [key, block(key, entries, of, isFair, opened)]);
    const real = blocks.filter(([, node]) => node);
    const [first, rest] = [
      real.filter(([key]) => FIRST.includes(key)),
      real.filter(([key]) => !FIRST.includes(key)),
    ];
    const wasOpen = body.querySelector("details.rest")?.open ?? first.length === 0;
    const isKnown = real.some(([key]) => key === "psnr_cc");
    const blank = isKnown ? "" : lack(entries, of);
    body.replaceChildren(
      h("p", { class: "hint", hidden: !blank }, blank),
      h(
        "div",
        { class: "charts" },
        first.map(([, node]) => node),
      ),
      rest.length > 0
        ? h(
            "details",
            { class: "rest", open: wasOpen },
            h("summary", {}, "Noise, time and size"),
            h(
              "div",
              { class: "charts" },
              rest.map(([, node]) => node),
            ),
          )
        : "",
    );
  }

  return {
    root,
    update(now, fair) {
      [entries, isFair] = [now, fair];
      root.hidden = !entries.some((one) => one.rounds.length > 0);
      if (root.hidden) return;
      if (!begun) {
        begun = true;
        const held = entries.some(
          (one) =>
            points(one, "psnr_cc", { image: "render", split: "held_out" }).length > 0 ||
            points(one, "own_psnr", { split: "held_out" }).length > 0,
        );
        split.value = held ? "held_out" : "train";
      }
      draw();
    },
  };
}

/** Why there is no score against ground truth. */
function lack(entries, of) {
  const others = SPLITS.some((split) =>
    entries.some((one) => points(one, "psnr_cc", { image: of.image, split }).length > 0),
  );
  return others
    ? "These views have no scores. Choose the other views above."
    : "None of these captures has ground truth. The scores show how well each scene agrees with " +
        "the photographs, not which one is better.";
}

/** Curve, table and text of one score; `null` if no job has it. */
function block(key, entries, of, isFair, opened) {
  const metric = METRICS[key];
  const there = entries
    .map((one) => ({ one, points: points(one, key, of) }))
    .filter((row) => row.points.length > 0);
  if (there.length === 0) return null;
  const series = there.map(({ one, points }) => ({
    label: called(one),
    style: one.style,
    mark: one.number,
    points,
  }));
  const most = key.endsWith("ssim") ? 1 : Infinity;
  const values = byRound(metric, there, isFair && !UNJUDGED.includes(key));
  // A single round makes no curve; a curve already shows its values.
  const isCurve = there.some((row) => row.points.length > 1);
  return h(
    "div",
    { class: "score" },
    isCurve ? chart(metric.title, series, metric.digits - 1, most) : h("h3", {}, metric.title),
    isCurve ? unfolding(key, opened, values) : values,
    h("p", { class: "hint" }, metric.means, " ", direction(metric)),
  );
}

function unfolding(key, opened, values) {
  const root = h("details", { open: opened.has(key) }, h("summary", {}, "Values by round"), values);
  root.addEventListener("toggle", () => (root.open ? opened.add(key) : opened.delete(key)));
  return root;
}

function byRound(metric, there, isFair) {
  const rounds = [...new Set(there.flatMap((row) => row.points.map(([round]) => round)))].sort(
    (a, b) => a - b,
  );
  const rows = rounds.map((round) => {
    const values = there.map((row) => row.points.find(([at]) => at === round)?.[1]);
    const isBest = isFair ? best(values, metric) : () => false;
    return h(
      "tr",
      {},
      h("th", { scope: "row" }, String(round)),
      values.map((value) => h("td", { class: "number" }, cell(value, metric, isBest(value)))),
    );
  });
  return h(
    "div",
    { class: "scroll", tabIndex: 0, role: "region", "aria-label": `${metric.title} by round` },
    h(
      "table",
      { class: "narrow" },
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          h("th", { scope: "col" }, "Round"),
          there.map(({ one }) => h("th", { scope: "col", class: "number" }, tag(one))),
        ),
      ),
      h("tbody", {}, rows),
    ),
  );
}
