// One view dark, enhanced, deblurred and rendered in every round, two pictures side by side.

import { TIMES, difference } from "../lib/difference.js";
import { address, fold, h } from "../lib/dom.js";
import { leap } from "../lib/place.js";
import { split } from "../lib/split.js";
import { thumbnails } from "../lib/strip.js";

/** Width of a depth picture, px. */
const DEPTH_WIDTH = 560;

/**
 * Keeps the comparison up to date: `update(names, rounds, hasTruth, notable)`; `notable` has the
 * names of the best, a typical and the poorest view if there are scores. `open(name)` goes to a
 * view.
 */
export function comparison(job) {
  const choice = h("select", { "aria-label": "View" });
  const slider = split();
  const shots = thumbnails(chosen, slider);
  const about = h("p", { class: "hint" });
  const quick = h("div", { class: "row quick", role: "group", "aria-label": "Views to look at" });
  const root = h("section", { hidden: true },
    h("div", { class: "row heading" }, h("h2", {}, "Views"), quick, choice),
    slider.root, slider.tools,
    h("div", {}, fold("Viewing tips", h("p", { class: "hint" }, "Drag the bar, or use the arrow keys, Home and End. Zoom all pictures of the view with + and −, two fingers, a double click, " +
      "or Ctrl and the wheel. Drag a zoomed picture to move it, or use Shift and the arrow keys."), about)),
    shots.root);
  let state = "";
  let facts = { names: [], rounds: [], hasTruth: false };
  // Kinds of the compared pictures, kept when another view is chosen.
  const sides = { left: "inputs", right: null };
  let [all, drawn] = [[], 0];
  choice.addEventListener("change", rebuild);

  function pick(name) {
    choice.value = name;
    rebuild();
  }

  const at = (path) => `v1/jobs/${job}/artifacts/${address(path)}`;

  function pictures(name) {
    const shot = (key, label, path) => ({ key, label, url: at(path) });
    /** @type {(ReturnType<typeof shot> | ReturnType<typeof made>)[]} */
    const list = [shot("inputs", "photograph", `inputs/${name}.jpg`)];
    for (const round of facts.rounds) {
      const of = (kind) => `rounds/${round}/${kind}/${name}.jpg`;
      for (const [kind, label] of [["enhanced", "enhanced"], ["deblurred", "deblurred"], ["renders", "rendered"]]) {
        list.push(shot(`${round}/${kind}`, `round ${round}, ${label}`, of(kind)));
      }
      if (!facts.hasTruth) list.push(differs(`${round}/difference`, `round ${round}, rendered − enhanced, × ${TIMES}`, [of("renders"), of("enhanced")]));
    }
    const last = facts.rounds.at(-1);
    if (last !== undefined) list.push(made(`${last}/depth`, `round ${last}, depth`, () => depth(name, last)));
    if (facts.hasTruth) {
      list.push(differs("difference", `restored − truth, × ${TIMES}`, [`restored/${name}.png`, `gt/${name}.jpg`]),
        shot("gt", "ground truth", `gt/${name}.jpg`));
    }
    return list;
  }

  /** A picture made once, when it is looked at; its brightness has a meaning. */
  function made(key, label, make) {
    let url = null;
    return {
      key,
      label,
      isFixed: true,
      make: () => (url ??= make()),
      forget: () => url?.then(URL.revokeObjectURL, () => {}),
    };
  }

  const differs = (key, label, [a, b]) => made(key, label, () => difference(at(a), at(b)));

  async function depth(view, round) {
    const query = new URLSearchParams({ view, round, show: "depth", width: String(DEPTH_WIDTH) });
    const answer = await fetch(`v1/jobs/${job}/render?${query}`);
    if (!answer.ok) throw new Error(`${answer.status}`);
    return URL.createObjectURL(await answer.blob());
  }

  function rebuild() {
    const before = all;
    all = pictures(choice.value);
    shots.fill(all);
    for (const picture of before) picture.forget?.();
    for (const button of quick.children) button.setAttribute("aria-pressed", String(button.value === choice.value));
    draw();
  }

  async function draw() {
    const find = (key) => all.find((picture) => picture.key === key);
    const left = find(sides.left) ?? all[0];
    const right = find(sides.right) ?? find(`${facts.rounds.at(-1)}/renders`) ?? all.at(-1);
    shots.mark(left.key, right.key);
    drawn += 1;
    const now = drawn;
    if (left.make || right.make) {
      // A picture that cannot be made is crossed out.
      const urls = await Promise.all([left, right].map((one) => one.url ?? one.make())).catch(() => null);
      if (urls && now === drawn) slider.show({ ...left, url: urls[0] }, { ...right, url: urls[1] });
      return;
    }
    slider.show(left, right);
  }

  function chosen(side, key) {
    sides[side] = key;
    draw();
  }

  function update(names, rounds, hasTruth, notable) {
    const now = JSON.stringify([names, rounds, hasTruth, notable]);
    if (now === state || names.length === 0) return;
    state = now;
    facts = { names, rounds, hasTruth };
    about.textContent = `${hasTruth ? TO_TRUTH : TO_ENHANCED} In depth pictures, near is bright, far is dark, and black is empty.`;
    const view = choice.value || notable?.typical;
    quick.replaceChildren(...Object.entries(notable ?? {}).map(([word, value]) =>
      h("button", { type: "button", value, onclick: () => pick(value) }, `${word[0].toUpperCase()}${word.slice(1)}`)));
    choice.replaceChildren(...names.map((one) => h("option", { value: one.name, selected: one.name === view },
      one.split === "held_out" ? `${one.name} (held out)` : one.name)));
    root.hidden = false;
    rebuild();
  }
  return {
    root,
    update,
    open(name) {
      pick(name);
      leap(root);
    },
  };
}

const TO_TRUTH = `The difference compares the best round's render, at its final brightness, with the ground truth. It is absolute and ${TIMES} times as bright. ` +
  "Black means agreement; an overall shift in colour or brightness also shows.";
const TO_ENHANCED = `Without ground truth, the difference compares a round's render with the enhanced photograph. It is absolute and ${TIMES} times as bright. ` +
  "The photograph is noisy and shaken and the render is not, so it shows where they disagree, not which of them is wrong.";
