// The same view dark, enhanced, deblurred and rendered in every round, two of them side by side.

import { address, h } from "./dom.js";
import { split } from "./split.js";

/** Keeps the comparison up to date: `update(names, rounds, hasTruth)`. */
export function comparison(job) {
  const choice = h("select", { "aria-label": "view" });
  const slider = split();
  const shots = thumbnails(chosen);
  const root = h("section", { hidden: true },
    h("div", { class: "row" }, h("h2", {}, "Views"), h("label", { class: "push" }, "View", choice)),
    slider.root, slider.tools,
    h("p", { class: "hint" }, "Drag the bar, or use the arrow keys, Home and End. Enlarge with + and −, a double click or Ctrl and the wheel; " +
      "move what is enlarged by dragging it, or with Shift and the arrow keys."),
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

/**
 * The pictures of a view: one stop of the Tab key, arrow keys within. A press puts a picture on the
 * side that is chosen above them, with Shift on the other.
 */
export function thumbnails(chosen) {
  let side = "left";
  const grid = h("div", { class: "shots", role: "group", "aria-label": "pictures of the view" });
  const sides = ["left", "right"].map((name) => h("button", { type: "button", "aria-pressed": String(name === side), onclick: () => choose(name) }, name));
  const root = h("div", {}, h("div", { class: "row sides", role: "group", "aria-label": "side" }, "Press a picture to see it on the", ...sides), grid);
  const buttons = () => [...grid.querySelectorAll("button:not(:disabled)")];

  function choose(name) {
    side = name;
    for (const button of sides) button.setAttribute("aria-pressed", String(button.textContent === name));
  }

  function shot(picture, i) {
    const image = h("img", { src: picture.url, alt: "", loading: "lazy" });
    const mark = h("span", { class: "mark" });
    const button = h("button", { type: "button", class: "shot", tabIndex: i === 0 ? 0 : -1, onclick: press },
      image, h("span", { class: "caption" }, picture.label, " ", mark));
    function press(event) {
      chosen(event.shiftKey === (side === "left") ? "right" : "left", picture.key);
    }
    image.addEventListener("error", () => { button.disabled = true; button.classList.add("missing"); });
    const figure = h("figure", {}, button);
    figure.say = (words) => { mark.textContent = words; figure.classList.toggle("chosen", words !== ""); };
    figure.key = picture.key;
    return figure;
  }

  grid.addEventListener("keydown", (event) => {
    const all = buttons();
    const at = all.indexOf(document.activeElement);
    const columns = all.filter((one) => one.offsetTop === all[0].offsetTop).length;
    const to = { ArrowLeft: at - 1, ArrowRight: at + 1, ArrowUp: at - columns, ArrowDown: at + columns, Home: 0, End: all.length - 1 }[event.key];
    if (at < 0 || to === undefined) return;
    event.preventDefault();
    if (!all[to]) return;
    all[at].tabIndex = -1;
    all[to].tabIndex = 0;
    all[to].focus();
  });

  return {
    root,
    fill(pictures) { grid.replaceChildren(...pictures.map(shot)); },
    mark(left, right) {
      for (const figure of grid.children) {
        figure.say([figure.key === left && "left", figure.key === right && "right"].filter(Boolean).join(", "));
      }
    },
  };
}
