// Jobs as cards or as a table: a choice that the browser remembers.

import { h } from "../lib/dom.js";
import { preload } from "../lib/modules.js";

const KEY = "fled list";
/** The modules are not needed to start a job, so they load after the form. */
const KINDS = {
  cards: { module: "pages/gallery.js", load: async () => (await import("./gallery.js")).gallery },
  table: { module: "pages/jobs.js", load: async () => (await import("./jobs.js")).jobTable },
};

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

/** A list of jobs like `jobTable`, with `choice`, the buttons that switch its layout. */
export function jobsIn(refresh) {
  let kind = remembered();
  let [shown, last, gone] = [null, null, false];
  const root = h("div");
  const buttons = Object.keys(KINDS).map((value) =>
    h("button", { type: "button", value, onclick: () => change(value) }, `${value[0].toUpperCase()}${value.slice(1)}`));
  const choice = h("div", { class: "row quick", role: "group", "aria-label": "Layout" }, buttons);
  const press = () => {
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.value === kind));
  };

  async function open() {
    const [asked, { module, load }] = [kind, KINDS[kind]];
    preload(module);
    const make = await load().catch(() => null);
    if (gone || asked !== kind) return;
    shown?.leave();
    shown = make?.(refresh);
    const lost = "The server did not send this list. Reload once it responds again.";
    root.replaceChildren(shown?.root ?? h("p", { class: "problem", role: "alert" }, lost));
    if (last) shown?.update(...last);
  }

  function change(to) {
    if (to === kind) return;
    kind = to;
    remember(kind);
    press();
    open();
  }

  press();
  open();
  return {
    root,
    choice,
    update(jobs, known) {
      last = [jobs, known];
      shown?.update(...last);
    },
    leave() {
      gone = true;
      shown?.leave();
    },
  };
}
