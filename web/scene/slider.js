// A slider with its value as text.

import { h } from "../lib/dom.js";

/**
 * `{ root, value(), set(value) }`; a double click resets it to `first`. Calls `changed(value)`,
 * with null for that double click.
 */
export function slider(name, style, { min, max, step, first, words, changed }) {
  const range = { min: String(min), max: String(max), step: String(step) };
  const input = h("input", { type: "range", ...range, "aria-label": name });
  const label = h("span", {});
  const value = () => Number(input.value);
  const set = (now) => {
    input.value = String(now);
    label.textContent = words(value());
    input.setAttribute("aria-valuetext", label.textContent);
  };
  input.addEventListener("input", () => { set(value()); changed?.(value()); });
  input.addEventListener("dblclick", () => { set(first); changed?.(null); });
  set(first);
  return { root: h("label", { class: `check ranged ${style}` }, label, input), value, set };
}
