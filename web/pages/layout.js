// Jobs as cards or as a table: a choice that the browser remembers.

import { h } from "../lib/dom.js";
import { gallery } from "./gallery.js";
import { jobTable } from "./jobs.js";

const KEY = "fled list";
const KINDS = { cards: gallery, table: jobTable };

/** The remembered kind, cards at first. If the browser refuses storage, nothing is remembered. */
function remembered() {
  try {
    const kind = localStorage.getItem(KEY);
    return kind in KINDS ? kind : "cards";
  } catch {
    return "cards";
  }
}

function remember(kind) {
  try {
    localStorage.setItem(KEY, kind);
  } catch { /* It lasts until the page is left. */ }
}

/**
 * A list of jobs like `jobTable`, with `choice`, the buttons that switch its layout. `redraw` is
 * called to fill a new layout.
 */
export function jobsIn(refresh, redraw) {
  let kind = remembered();
  let shown = KINDS[kind](refresh);
  const root = h("div", {}, shown.root);
  const buttons = Object.keys(KINDS).map((value) =>
    h("button", { type: "button", value, onclick: () => change(value) }, `${value[0].toUpperCase()}${value.slice(1)}`));
  const choice = h("div", { class: "row quick", role: "group", "aria-label": "Layout" }, buttons);
  const press = () => {
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.value === kind));
  };

  function change(to) {
    if (to === kind) return;
    shown.leave();
    kind = to;
    remember(kind);
    shown = KINDS[kind](refresh);
    root.replaceChildren(shown.root);
    press();
    redraw();
  }

  press();
  return {
    root,
    choice,
    update: (jobs, known) => shown.update(jobs, known),
    leave: () => shown.leave(),
  };
}
