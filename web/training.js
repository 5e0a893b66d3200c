// How a job trains, while it does: the loss of every 25 steps, by round.

import { h, s, section, show } from "./dom.js";
import { ticks } from "./chart.js";

const WIDTH = 860;
const HEIGHT = 200;
const MARGIN = { left: 52, right: 12, top: 8, bottom: 24 };
/** What a new value counts for in the line: views differ, so their losses scatter about it. */
const SHARE = 0.3;
/** Colours of the style sheet. */
const COLOURS = 3;

/** `{ root, see }`: `see` takes what an event `training_seen` says. */
export function trainingCurve() {
  const root = section("Training");
  /** Losses by step, by round: an attempt that goes on from a checkpoint tells some steps twice. */
  const rounds = new Map();
  let [last, frame] = [null, 0];

  function see(told) {
    if (typeof told.loss !== "number") return;
    if (!rounds.has(told.round)) rounds.set(told.round, new Map());
    rounds.get(told.round).set(told.step, told.loss);
    last = told;
    // The whole history comes at once at first.
    if (!frame) frame = requestAnimationFrame(() => { frame = 0; draw(); });
  }

  function draw() {
    const lines = [...rounds].sort(([a], [b]) => a - b)
      .map(([round, losses]) => [round, [...losses].sort(([a], [b]) => a - b)]);
    const line = `Round ${last.round}, step ${last.step.toLocaleString("en")} of ${last.steps.toLocaleString("en")}: ` +
      `${last.gaussians.toLocaleString("en")} Gaussians`;
    show(root, h("div", { class: "chart training" }, plot(lines, last.steps),
      h("div", { class: "legend" }, lines.map(([round]) => h("span", {}, h("i", { class: colour(round) }), `round ${round}`)))),
    h("p", { class: "hint" }, `${line}. The loss says how far renders are from the views that train; each dot is one view, the line their course.`));
  }
  return { root, see };
}

const colour = (round) => `c${(round - 1) % COLOURS}`;

function plot(lines, steps) {
  const losses = lines.flatMap(([, points]) => points.map(([, loss]) => loss));
  // A single first loss far above the others would press the rest flat.
  const high = losses.toSorted((a, b) => a - b)[Math.floor(0.98 * (losses.length - 1))] * 1.15;
  const x = (step) => MARGIN.left + (step / steps) * (WIDTH - MARGIN.left - MARGIN.right);
  const y = (loss) => MARGIN.top + (1 - Math.min(loss, high) / high) * (HEIGHT - MARGIN.top - MARGIN.bottom);
  const svg = s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": "Loss by step" });
  for (const [value, label] of ticks(0, high)) {
    svg.append(
      s("line", { class: "grid", x1: MARGIN.left, x2: WIDTH - MARGIN.right, y1: y(value), y2: y(value) }),
      s("text", { class: "tick", x: MARGIN.left - 6, y: y(value) + 4, "text-anchor": "end" }, label));
  }
  for (const [step, label] of ticks(0, steps)) {
    svg.append(s("text", { x: x(step), y: HEIGHT - 6, "text-anchor": "middle" }, Number(label).toLocaleString("en")));
  }
  for (const [round, points] of lines) {
    for (const [step, loss] of points) svg.append(s("circle", { class: `seen ${colour(round)}`, cx: x(step), cy: y(loss), r: 2 }));
    svg.append(s("path", { class: `line ${colour(round)}`, d: course(points, x, y) }));
  }
  return svg;
}

/** A line through points that follows them slowly. */
function course(points, x, y) {
  let mean = points[0]?.[1];
  return points.map(([step, loss], i) => {
    mean += (loss - mean) * Math.max(SHARE, 1 / (i + 1));
    return `${i ? "L" : "M"}${x(step).toFixed(1)} ${y(mean).toFixed(1)}`;
  }).join("");
}
