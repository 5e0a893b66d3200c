// Line charts over rounds, without a library, as they have few points.

import { h, s } from "./dom.js";

const WIDTH = 420;
const HEIGHT = 210;
/** Most grid lines, less one. */
const TICKS = 5;
/** Most rounds labelled with the word "round" below a chart. */
const MOST_WORDS = 7;
const MARGIN = { left: 50, right: 12, top: 8, bottom: 24 };
/** Half the side of a mark. */
const SIZE = 4;

/** Marks by number, which distinguish lines without colour vision. */
const MARKS = [
  (a) => `M${-a} 0a${a} ${a} 0 1 0 ${2 * a} 0a${a} ${a} 0 1 0 ${-2 * a} 0Z`,
  (a) => `M${-a} ${-a}H${a}V${a}H${-a}Z`,
  (a) => `M0 ${-1.3 * a}L${1.2 * a} ${a}H${-1.2 * a}Z`,
  (a) => `M0 ${-1.4 * a}L${1.4 * a} 0L0 ${1.4 * a}L${-1.4 * a} 0Z`,
  (a) => `M0 ${1.3 * a}L${1.2 * a} ${-a}H${-1.2 * a}Z`,
  (a) =>
    `M${-a} ${-a * 0.4}H${-a * 0.4}V${-a}H${a * 0.4}V${-a * 0.4}H${a}V${a * 0.4}` +
    `H${a * 0.4}V${a}H${-a * 0.4}V${a * 0.4}H${-a}Z`,
];

/** A single mark, as in a legend. */
export const mark = (number, style) =>
  s(
    "svg",
    { class: `key ${style}`, viewBox: "-7 -7 14 14", width: 14, height: 14, "aria-hidden": "true" },
    s("path", { class: `dot full ${style}`, d: MARKS[number](5) }),
  );

/**
 * A chart of `series`: [{ label, colour: 0..2, dashed, points: [[round, value], ...] }]; `style`
 * and `mark` may replace the colour. No value is above `most`. The legend has the values of one
 * round, chosen by pointer or arrow keys.
 */
export function chart(title, series, digits, most = Infinity) {
  const points = series.flatMap((one) => one.points);
  if (points.length === 0) return null;
  const rounds = [...new Set(points.map(([round]) => round))].sort((a, b) => a - b);
  const scales = {
    x: across(rounds),
    y: up(
      range(
        points.map(([, value]) => value),
        most,
      ),
    ),
  };
  const svg = s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": title });
  drawGrid(svg, rounds, scales);
  const rule = s("line", { class: "rule", y1: MARGIN.top, y2: HEIGHT - MARGIN.bottom });
  svg.append(rule);
  for (const one of series) drawLine(svg, one, scales, digits);
  const plot = h(
    "div",
    {
      class: "plot",
      tabIndex: 0,
      role: "group",
      "aria-label": `${title}: use the arrow keys to choose a round`,
    },
    svg,
  );
  const legend = legendOf(series, digits);
  const shared = rounds.filter((round) =>
    series.every((one) => one.points.some(([at]) => at === round)),
  );
  pick(plot, rounds, shared.at(-1) ?? rounds.at(-1), scales.x, (round) => {
    rule.setAttribute("x1", scales.x(round));
    rule.setAttribute("x2", scales.x(round));
    legend.show(round);
  });
  return h("div", { class: "chart" }, h("h3", {}, title), plot, legend.root);
}

const styleOf = (one) => one.style ?? `c${one.colour}`;

function across(rounds) {
  const [first, last] = [rounds[0], rounds.at(-1)];
  return (round) => {
    const share = last === first ? 0.5 : (round - first) / (last - first);
    return MARGIN.left + 14 + share * (WIDTH - MARGIN.left - MARGIN.right - 28);
  };
}

function up([low, high]) {
  const y = (value) => {
    const share = (value - low) / (high - low);
    return MARGIN.top + (1 - share) * (HEIGHT - MARGIN.top - MARGIN.bottom);
  };
  return Object.assign(y, { low, high });
}

function drawGrid(svg, rounds, { x, y }) {
  for (const [value, label] of ticks(y.low, y.high)) {
    svg.append(
      s("line", {
        class: "grid",
        x1: MARGIN.left,
        x2: WIDTH - MARGIN.right,
        y1: y(value),
        y2: y(value),
      }),
      s(
        "text",
        { class: "tick", x: MARGIN.left - 6, y: y(value) + 4, "text-anchor": "end" },
        label,
      ),
    );
  }
  // More labels have no room for the word.
  const word = rounds.length > MOST_WORDS ? "" : "round ";
  for (const round of rounds) {
    svg.append(
      s("text", { x: x(round), y: HEIGHT - 6, "text-anchor": "middle" }, `${word}${round}`),
    );
  }
}

function drawLine(svg, one, { x, y }, digits) {
  const dashed = one.dashed ? " dashed" : "";
  const path = one.points.map(([round, value], i) => `${i ? "L" : "M"}${x(round)} ${y(value)}`);
  svg.append(s("path", { class: `line ${styleOf(one)}${dashed}`, d: path.join("") }));
  for (const [round, value] of one.points) {
    svg.append(
      s(
        "path",
        {
          class: `dot ${styleOf(one)}${one.dashed ? "" : " full"}`,
          d: MARKS[one.mark ?? 0](SIZE - (one.mark ? 0 : 0.5)),
          transform: `translate(${x(round)} ${y(value)})`,
        },
        s("title", {}, `${one.label}, round ${round}: ${value.toFixed(digits + 1)}`),
      ),
    );
  }
}

/** The lines by name, each with its value in the chosen round. */
function legendOf(series, digits) {
  const of = h("span", { class: "of" });
  const rows = series.map((one) => {
    const value = h("b", {});
    const line = h("i", { class: `${styleOf(one)}${one.dashed ? " dashed" : ""}` });
    const sign = one.mark === undefined ? line : mark(one.mark, styleOf(one));
    return { one, value, node: h("span", {}, sign, one.label, " ", value) };
  });
  const root = h(
    "div",
    { class: "legend", "aria-live": "polite", "aria-atomic": "true" },
    of,
    rows.map((row) => row.node),
  );
  return {
    root,
    show(round) {
      of.textContent = `Round ${round}:`;
      for (const { one, value } of rows) {
        const found = one.points.find(([at]) => at === round);
        value.textContent = found ? found[1].toFixed(digits + 1) : "–";
      }
    },
  };
}

/** Chooses a round: the nearest by pointer or finger, the next by arrow keys. */
function pick(plot, rounds, first, x, chosen) {
  let now = first;
  const go = (round) => {
    if (round === undefined || round === now) return;
    now = round;
    chosen(round);
  };
  const at = (event) => {
    const box = plot.getBoundingClientRect();
    const px = ((event.clientX - box.left) / box.width) * WIDTH;
    const far = (round) => Math.abs(x(round) - px);
    go(rounds.reduce((best, round) => (far(round) < far(best) ? round : best)));
  };
  plot.addEventListener("pointermove", at);
  plot.addEventListener("pointerdown", at);
  plot.addEventListener("keydown", (event) => {
    const place = rounds.indexOf(now);
    const to = { ArrowLeft: place - 1, ArrowRight: place + 1, Home: 0, End: rounds.length - 1 };
    if (to[event.key] === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    go(rounds[to[event.key]]);
  });
  chosen(now);
}

/** Round values within a range, with enough decimals to distinguish them. */
export function ticks(low, high) {
  const rough = (high - low) / TICKS;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10]
    .map((factor) => factor * power)
    .find((candidate) => candidate >= rough * (1 - 1e-9));
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++)
    found.push([i * step, (i * step).toFixed(decimals)]);
  return found;
}

/**
 * A range that holds the values with some room, and nothing above `most`.
 * @returns {[number, number]}
 */
export function range(values, most) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const room = (high - low) * 0.12 || Math.abs(high) * 0.05 || 1;
  return [low - room, Math.min(high + room, Math.max(most, high))];
}
