// Lines over rounds, drawn by hand: few points, no library.

import { h, s } from "./dom.js";

const WIDTH = 420;
const HEIGHT = 210;
/** Lines of the grid at most, less one. */
const TICKS = 5;
const MARGIN = { left: 42, right: 12, top: 8, bottom: 24 };

/** A chart of `series`: [{ label, colour: 0..2, dashed, points: [[round, value], ...] }]; no value is above `most`. */
export function chart(title, series, digits, most = Infinity) {
  const points = series.flatMap((one) => one.points);
  if (points.length === 0) return null;
  const rounds = [...new Set(points.map(([round]) => round))].sort((a, b) => a - b);
  const [low, high] = range(points.map(([, value]) => value), most);
  const x = (round) => {
    const [first, last] = [rounds[0], rounds.at(-1)];
    const share = last === first ? 0.5 : (round - first) / (last - first);
    return MARGIN.left + 14 + share * (WIDTH - MARGIN.left - MARGIN.right - 28);
  };
  const y = (value) => MARGIN.top + (1 - (value - low) / (high - low)) * (HEIGHT - MARGIN.top - MARGIN.bottom);
  const svg = s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": title });
  for (const [value, label] of ticks(low, high)) {
    svg.append(
      s("line", { class: "grid", x1: MARGIN.left, x2: WIDTH - MARGIN.right, y1: y(value), y2: y(value) }),
      s("text", { class: "tick", x: MARGIN.left - 6, y: y(value) + 4, "text-anchor": "end" }, label));
  }
  for (const round of rounds) {
    svg.append(s("text", { x: x(round), y: HEIGHT - 6, "text-anchor": "middle" }, `round ${round}`));
  }
  for (const one of series) {
    const style = `c${one.colour}${one.dashed ? " dashed" : ""}`;
    const path = one.points.map(([round, value], i) => `${i ? "L" : "M"}${x(round)} ${y(value)}`).join("");
    svg.append(s("path", { class: `line ${style}`, d: path }));
    for (const [round, value] of one.points) {
      svg.append(s("circle", { class: `dot c${one.colour}${one.dashed ? "" : " full"}`, cx: x(round), cy: y(value), r: 3.5 },
        s("title", {}, `${one.label}, round ${round}: ${value.toFixed(digits + 1)}`)));
    }
  }
  const legend = series.map((one) => h("span", {}, h("i", { class: `c${one.colour}${one.dashed ? " dashed" : ""}` }), one.label));
  return h("div", { class: "chart" }, h("h3", {}, title), svg, h("div", { class: "legend" }, legend));
}

/** Round values within a range, with as many decimals as tell them apart. */
export function ticks(low, high) {
  const rough = (high - low) / TICKS;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough * (1 - 1e-9));
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++) found.push([i * step, (i * step).toFixed(decimals)]);
  return found;
}

function range(values, most) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const room = (high - low) * 0.12 || Math.abs(high) * 0.05 || 1;
  return [low - room, Math.min(high + room, Math.max(most, high))];
}
