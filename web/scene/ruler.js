// A ruler for the scene: two points, their distance, and what a unit is in metres.

import { h } from "../lib/dom.js";
import { along } from "./camera.js";
import { drawLines } from "./lines.js";

/** Digits of lengths in units, and of the metres of a unit. */
const SHOWN = 4;
const EXACT = 6;
/** @type {[string, number]} */
const LINE = ["#ff8fd0", 1.8];
/** Half the size of a point's cross, in radii of the photographers' ring. */
const CROSS = 0.015;
const AIMS = ["Choose the first point", "Choose the second point"];

/** The scales that exports take. */
const LIMITS = [1e-6, 1e6];

/** Metres of a unit in which `units` are `metres`; `null` if that is no scale for exports. */
export function scaleOf(metres, units) {
  const scale = Number((metres / units).toPrecision(EXACT));
  return scale >= LIMITS[0] && scale <= LIMITS[1] ? scale : null;
}

/**
 * `shaping` holds the scale; `ask(what, isCropped)` is a promise of a point of the drawn scene that
 * the user picks, or of `null`; `changed` is called when the points change. Returns
 * `{ choice, row, show(), isShown(), draw(context, pose, k, near) }`.
 */
export function ruler(shaping, { radius }, world, ask, changed) {
  let points = [];
  const units = () => Math.hypot(...along(points[0], points[1], -1)) / world.scale;
  const button = (title, onclick, text) => h("button", { type: "button", title, onclick }, text);
  const choice = button("Measure between two points", measure, "Measure");
  const apart = h("span", {});
  const metres = h("input", {
    type: "number", min: "0", step: "any", inputMode: "decimal",
    "aria-label": "Their distance in metres",
    oninput: () => shaping.change({ scale: scaleOf(metres.valueAsNumber, units()) }),
    onchange: () => show(),
  });
  const known = h("label", { class: "check axis" }, metres, "m");
  const unit = h("span", { role: "status" });
  const clear = button("Forget the points and the scale", () => {
    points = [];
    shaping.change({ scale: null });
    changed();
  }, "Clear");
  const row = h("div", { class: "row shapes", role: "group", "aria-label": "Ruler" },
    apart, known, unit, clear);

  async function measure() {
    const mine = [];
    points = mine;
    for (const asked of AIMS) {
      show();
      const point = await ask(asked, true);
      // Cleared or begun anew meanwhile.
      if (points !== mine) return;
      if (point) mine.push(point);
      else points = [];
      changed();
      if (!point) break;
    }
    // A double click.
    if (points.length === 2 && units() === 0) points = [];
    show();
    if (points.length === 2) metres.focus({ preventScroll: true });
  }

  function show() {
    const { isOffered, scale } = shaping.now;
    const isMeasured = points.length === 2;
    choice.hidden = !isOffered;
    row.hidden = !isMeasured && scale === null;
    apart.hidden = known.hidden = !isMeasured;
    if (isMeasured) {
      apart.textContent = `The points are ${units().toPrecision(SHOWN)} units apart:`;
      // What is being typed stays.
      if (scale === null && document.activeElement !== metres) metres.value = "";
      if (scale !== null && scale !== scaleOf(metres.valueAsNumber, units())) {
        metres.value = String(Number((units() * scale).toPrecision(SHOWN)));
      }
    }
    const isGiven = metres.value !== "" || metres.validity.badInput;
    const isWrong = isMeasured && scale === null && isGiven;
    if (isWrong) metres.setAttribute("aria-invalid", "true");
    else metres.removeAttribute("aria-invalid");
    const words = scale === null ? "" : `1 unit is ${scale} m`;
    unit.textContent = isWrong ? "must be a positive number" : words;
  }

  show();
  return {
    choice,
    row,
    show,
    isShown: () => points.length > 0,
    draw(context, pose, k, near) {
      const cross = (point) => pose.axes.slice(0, 2).map((axis) =>
        [-1, 1].map((sign) => along(point, axis, sign * CROSS * radius)));
      const line = points.length === 2 ? [points] : [];
      drawLines(context, pose, k, [...points.flatMap(cross), ...line], near, LINE);
    },
  };
}
