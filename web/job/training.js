// A job's training while it runs: its loss, the scores of held-out views, and a live render of
// one view.

import { folding, h, isNarrow, s, show } from "../lib/dom.js";
import { range, ticks } from "../lib/chart.js";
import { meanings } from "../lib/words.js";

const WIDTH = 420;
const HEIGHT = 200;
const MARGIN = { left: 46, right: 12, top: 8, bottom: 24 };
/** Weight of a new loss in the trend line; losses of different views scatter about it. */
const SHARE = 0.3;
/** Share of losses that may lie above the chart, as an early one would flatten the rest. */
const BEYOND = 0.02;
/** Line colours in the style sheet. */
const COLOURS = 3;

/**
 * `{ root, see, over }` of the job at `base`: `see(kind, event)` takes an event of its stream,
 * `over` removes the picture.
 */
export function trainingView(base) {
  const root = folding("Training");
  const lines = root.querySelector("details");
  lines.open = true;
  const loss = curve("Loss", 4, true);
  const scores = { psnr_cc_db: curve("", 2, false), ssim: curve("", 3, false, 1) };
  const picture = livePicture(base);
  const status = h("p", { class: "hint" });
  const agreement = h("p", { class: "hint", hidden: true },
    "Without ground truth, renders are compared with the photographs that fled brightened. This is agreement, not quality: both can be wrong in the same way.");
  const words = h("div");
  const grid = h("div", { class: "live" }, loss.root, picture.root, scores.psnr_cc_db.root, scores.ssim.root);
  let [last, named, frame] = [null, null, 0];

  const kinds = {
    training_seen(event) {
      if (typeof event.loss !== "number") return;
      loss.add(event, event.loss);
      last = event;
    },
    held_out_seen(event) {
      for (const [key, chart] of Object.entries(scores)) chart.add(event, event[key]);
      if (named !== event.truth) name(event);
    },
    view_seen: picture.see,
  };

  /** Sets the titles, which depend on whether there is ground truth. */
  function name({ truth, views }) {
    named = truth;
    const of = `${views} held-out view${views === 1 ? "" : "s"}`;
    const what = truth ? "" : "Agreement, ";
    scores.psnr_cc_db.title(`${what}PSNR of ${of}, dB`);
    scores.ssim.title(`${what}SSIM of ${of}`);
    agreement.hidden = truth;
    words.replaceChildren(meanings(truth ? ["live_psnr", "live_ssim"] : ["live_own_psnr", "live_own_ssim"]));
  }

  function see(kind, event) {
    kinds[kind]?.(event);
    // The stream begins with the whole history at once.
    if (!frame) frame = requestAnimationFrame(() => { frame = 0; draw(); });
  }

  function draw() {
    if (!last) return;
    if (root.hidden) show(root, grid, agreement, status, words);
    for (const chart of [loss, ...Object.values(scores)]) chart.draw(last.steps);
    root.gist.textContent = `loss ${loss.last()}`;
    status.textContent = `Round ${last.round}, step ${last.step.toLocaleString("en")} of ${last.steps.toLocaleString("en")}: ` +
      `${last.gaussians.toLocaleString("en")} Gaussians. The loss measures how far renders are from the training views. Each dot is one view; the line is the trend.`;
  }

  /** Keeps the curves, folded away on a phone that did not see them grow. */
  function over() {
    picture.over();
    if (root.hidden) lines.open = !isNarrow();
  }

  return { root, see, over };
}

/** Event names that `see` takes. */
export const SEEN = ["training_seen", "held_out_seen", "view_seen"];

/**
 * Values by step, a line per round: `{ root, title, add, draw }`; hidden while there are none.
 * Scattering values are drawn as dots about their trend line, on an axis from 0.
 */
function curve(name, digits, scatters, most = Infinity) {
  /** Values by step, by round: an attempt resumed from a checkpoint reports some twice. */
  const rounds = new Map();
  const heading = h("h3", {}, name);
  const [place, legend] = [h("div"), h("div", { class: "legend" })];
  const root = h("div", { class: "chart training", hidden: true }, heading, place, legend);
  return {
    root,
    last: () => legend.querySelector(":scope > :last-child b")?.textContent,
    title(text) { heading.textContent = text; },
    add({ round, step }, value) {
      if (typeof value !== "number") return;
      if (!rounds.has(round)) rounds.set(round, new Map());
      rounds.get(round).set(step, value);
      root.hidden = false;
    },
    draw(steps) {
      if (root.hidden) return;
      const lines = [...rounds].sort(([a], [b]) => a - b)
        .map(([round, values]) => [round, [...values].sort(([a], [b]) => a - b)]);
      place.replaceChildren(plot(heading.textContent, lines, steps, { scatters, most }));
      legend.replaceChildren(...lines.map(([round, points]) =>
        h("span", {}, h("i", { class: colour(round) }), `round ${round} `, h("b", {}, points.at(-1)[1].toFixed(digits)))));
    },
  };
}

const colour = (round) => `c${(round - 1) % COLOURS}`;

function plot(name, lines, steps, { scatters, most }) {
  const values = lines.flatMap(([, points]) => points.map(([, value]) => value));
  const [low, high] = scatters ? [0, 1.15 * highest(values)] : range(values, most);
  const x = (step) => MARGIN.left + (step / steps) * (WIDTH - MARGIN.left - MARGIN.right);
  const y = (value) => MARGIN.top + (1 - (Math.min(value, high) - low) / (high - low)) * (HEIGHT - MARGIN.top - MARGIN.bottom);
  const svg = s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${name}, by step` });
  for (const [value, label] of ticks(low, high)) {
    svg.append(
      s("line", { class: "grid", x1: MARGIN.left, x2: WIDTH - MARGIN.right, y1: y(value), y2: y(value) }),
      s("text", { class: "tick", x: MARGIN.left - 6, y: y(value) + 4, "text-anchor": "end" }, label));
  }
  for (const [step, label] of ticks(0, steps)) {
    const end = x(step) > WIDTH - 2 * MARGIN.right;
    svg.append(s("text", { x: end ? WIDTH - 2 : x(step), y: HEIGHT - 6, "text-anchor": end ? "end" : "middle" }, Number(label).toLocaleString("en")));
  }
  for (const [round, points] of lines) {
    const dot = `${scatters ? "seen" : "score"} ${colour(round)}`;
    for (const [step, value] of points) svg.append(s("circle", { class: dot, cx: x(step), cy: y(value), r: scatters ? 2 : 3 }));
    svg.append(s("path", { class: `line ${colour(round)}`, d: course(points, x, y, scatters ? SHARE : 1) }));
  }
  return svg;
}

const highest = (values) => values.toSorted((a, b) => a - b)[Math.floor((1 - BEYOND) * (values.length - 1))];

/** A line through points; a smaller `share` follows them more slowly. */
function course(points, x, y, share) {
  let mean = points[0]?.[1];
  return points.map(([step, value], i) => {
    mean += (value - mean) * Math.max(share, 1 / (i + 1));
    return `${i ? "L" : "M"}${x(step).toFixed(1)} ${y(mean).toFixed(1)}`;
  }).join("");
}

/** The latest picture of the scene in training: `{ root, see, over }`. */
function livePicture(base) {
  const image = h("img", { alt: "" });
  const caption = h("figcaption");
  const root = h("figure", { class: "seen", hidden: true }, h("h3", {}, "Live view"), image, caption);
  let [wanted, busy, shown, isOver] = [null, false, "", false];

  function see(event) {
    wanted = event;
    if (busy || isOver) return;
    busy = true;
    // Only the last picture of the history exists.
    requestAnimationFrame(load);
  }

  async function load() {
    while (wanted && !isOver) {
      const event = wanted;
      wanted = null;
      // A picture that fails to load is replaced by the next.
      const answer = await fetch(`${base}/live`).catch(() => null);
      if (answer?.status === 200 && !isOver) await put(URL.createObjectURL(await answer.blob()), event);
    }
    busy = false;
  }

  async function put(url, event) {
    image.src = url;
    image.alt = `Render of view ${event.view}`;
    caption.textContent = `${event.view} (${event.held_out ? "held out" : "training view"}), round ${event.round}, step ${event.step.toLocaleString("en")}`;
    root.hidden = false;
    await image.decode().catch(() => {});
    if (shown) URL.revokeObjectURL(shown);
    shown = url;
  }

  return {
    root,
    see,
    over() {
      isOver = true;
      root.hidden = true;
      if (shown) URL.revokeObjectURL(shown);
      shown = "";
    },
  };
}
