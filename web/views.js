// The same view dark, enhanced, deblurred and rendered in every round, two of them side by side.

import { address, fold, h } from "./dom.js";
import { split } from "./split.js";
import { thumbnails } from "./strip.js";

/** Keeps the comparison up to date: `update(names, rounds, hasTruth)`. */
export function comparison(job) {
  const choice = h("select", { "aria-label": "view" });
  const slider = split();
  const shots = thumbnails(chosen, slider);
  const root = h("section", { hidden: true },
    h("div", { class: "row" }, h("h2", {}, "Views"), h("label", { class: "push" }, "View", choice)),
    slider.root, slider.tools,
    fold("How to look closer", h("p", { class: "hint" }, "Drag the bar, or use the arrow keys, Home and End. Enlarge all pictures of the view with + and −, two fingers, a double click, " +
      "or Ctrl and the wheel; move what is enlarged by dragging it, or with Shift and the arrow keys.")),
    shots.root);
  let state = "";
  let facts = { names: [], rounds: [], hasTruth: false };
  // What is compared, by kind: kept when another view is chosen.
  const sides = { left: "inputs", right: null };
  let all = [];
  choice.addEventListener("change", rebuild);

  function pictures(name) {
    const list = [["inputs", "dark input", `inputs/${name}.jpg`]];
    for (const round of facts.rounds) {
      for (const [kind, label] of [["enhanced", "enhanced"], ["deblurred", "deblurred"], ["renders", "rendered"]]) {
        list.push([`${round}/${kind}`, `round ${round}, ${label}`, `rounds/${round}/${kind}/${name}.jpg`]);
      }
    }
    if (facts.hasTruth) list.push(["gt", "ground truth", `gt/${name}.jpg`]);
    return list.map(([key, label, path]) => ({ key, label, url: `/v1/jobs/${job}/artifacts/${address(path)}` }));
  }

  function rebuild() {
    all = pictures(choice.value);
    shots.fill(all);
    draw();
  }

  function draw() {
    const find = (key) => all.find((picture) => picture.key === key);
    const left = find(sides.left) ?? all[0];
    const right = find(sides.right) ?? find(`${facts.rounds.at(-1)}/renders`) ?? all.at(-1);
    slider.show(left, right);
    shots.mark(left.key, right.key);
  }

  function chosen(side, key) {
    sides[side] = key;
    draw();
  }

  function update(names, rounds, hasTruth) {
    const now = JSON.stringify([names, rounds, hasTruth]);
    if (now === state || names.length === 0) return;
    state = now;
    facts = { names, rounds, hasTruth };
    const view = choice.value;
    choice.replaceChildren(...names.map((one) => h("option", { value: one.name, selected: one.name === view },
      one.split === "held_out" ? `${one.name} (held out)` : one.name)));
    root.hidden = false;
    rebuild();
  }
  return { root, update };
}
