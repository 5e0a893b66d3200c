// The same view dark, enhanced, deblurred and rendered in every round, with a slider between two.

import { address, h } from "./dom.js";

/** Of the comparison, px. */
const LARGEST_HEIGHT = 560;

/** Keeps the comparison up to date: `update(names, rounds, hasTruth)`. */
export function comparison(job) {
  const choice = h("select", { "aria-label": "view" });
  const shots = h("div", { class: "shots" });
  const slider = split();
  const root = h("section", { hidden: true },
    h("div", { class: "row" }, h("h2", {}, "Views"), h("label", { class: "push" }, "View", choice)),
    slider.root, h("p", { class: "hint" }, "Drag the bar. Click a picture for the left side, with Shift for the right."), shots);
  let state = "";
  let facts = { names: [], rounds: [], hasTruth: false };
  // What is compared, by kind: kept when another view is chosen.
  let [left, right] = ["inputs", null];
  choice.addEventListener("change", draw);

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

  function draw() {
    const all = pictures(choice.value);
    const find = (key) => all.find((picture) => picture.key === key);
    const last = facts.rounds.at(-1);
    const [a, b] = [find(left) ?? all[0], find(right) ?? find(`${last}/renders`) ?? all.at(-1)];
    slider.show(a, b);
    shots.replaceChildren(...all.map((picture) => {
      const chosen = picture === a || picture === b;
      const figure = h("figure", {
        class: chosen ? "chosen" : "",
        onclick: (event) => { if (event.shiftKey) right = picture.key; else left = picture.key; draw(); },
      });
      const image = h("img", { src: picture.url, alt: picture.label, loading: "lazy", onerror: () => figure.classList.add("missing") });
      figure.append(image, h("figcaption", {}, picture.label));
      return figure;
    }));
  }

  function update(names, rounds, hasTruth) {
    const now = JSON.stringify([names, rounds, hasTruth]);
    if (now === state || names.length === 0) return;
    state = now;
    facts = { names, rounds, hasTruth };
    const chosen = choice.value;
    choice.replaceChildren(...names.map((view) => h("option", { value: view.name, selected: view.name === chosen },
      view.split === "held_out" ? `${view.name} (held out)` : view.name)));
    root.hidden = false;
    draw();
  }
  return { root, update };
}

/** Two pictures on top of each other with a bar between them. */
function split() {
  const below = h("img", { alt: "", draggable: false });
  const top = h("img", { class: "top", alt: "", draggable: false });
  const bar = h("div", { class: "bar" });
  const [left, right] = [h("span", { class: "left" }), h("span", { class: "right" })];
  const root = h("div", { class: "compare", tabIndex: 0, role: "slider", "aria-label": "comparison", "aria-valuemin": "0", "aria-valuemax": "100" }, below, top, bar, left, right);
  let share = 0.5;
  function place(value) {
    share = Math.min(1, Math.max(0, value));
    top.style.clipPath = `inset(0 ${100 * (1 - share)}% 0 0)`;
    bar.style.left = `${100 * share}%`;
    root.setAttribute("aria-valuenow", Math.round(100 * share));
  }
  const follow = (event) => {
    const box = root.getBoundingClientRect();
    place((event.clientX - box.left) / box.width);
  };
  root.addEventListener("pointerdown", (event) => { root.setPointerCapture(event.pointerId); follow(event); });
  root.addEventListener("pointermove", (event) => { if (event.buttons) follow(event); });
  root.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.05, ArrowRight: 0.05 }[event.key];
    if (step) { place(share + step); event.preventDefault(); }
  });
  // Small pictures are enlarged, tall ones kept on the screen.
  below.addEventListener("load", () => {
    root.style.maxWidth = `${Math.min(720, (LARGEST_HEIGHT * below.naturalWidth) / below.naturalHeight)}px`;
  });
  place(0.5);
  return {
    root,
    show(a, b) {
      top.src = a.url;
      below.src = b.url;
      left.textContent = a.label;
      right.textContent = b.label;
    },
  };
}

/** A view that nobody photographed: drag to turn, wheel to come nearer. */
export function novelView(job) {
  const image = h("img", { alt: "rendered view", draggable: false });
  const caption = h("p", { class: "hint" });
  const frame = h("div", { class: "view", tabIndex: 0, "aria-label": "novel view, arrow keys turn" }, image);
  const choice = h("select", { "aria-label": "round" });
  const root = h("section", { hidden: true },
    h("div", { class: "row" }, h("h2", {}, "Novel view"), h("label", { class: "push" }, "Round", choice)),
    frame, caption);
  const pose = { azimuth: 0, elevation: 0, distance: 1 };
  let [busy, again, shown] = [false, false, ""];

  async function draw() {
    if (busy) { again = true; return; }
    busy = true;
    frame.classList.add("busy");
    do {
      again = false;
      const query = new URLSearchParams({
        azimuth: pose.azimuth.toFixed(1), elevation: pose.elevation.toFixed(1), distance: pose.distance.toFixed(2), width: "640",
      });
      if (choice.value) query.set("round", choice.value);
      try {
        const response = await fetch(`/v1/jobs/${job}/render?${query}`);
        if (!response.ok) throw new Error((await response.json()).detail);
        const url = URL.createObjectURL(await response.blob());
        image.src = url;
        await image.decode().catch(() => {});
        if (shown) URL.revokeObjectURL(shown);
        shown = url;
        caption.textContent = `azimuth ${pose.azimuth.toFixed(0)}°, elevation ${pose.elevation.toFixed(0)}°, distance ${pose.distance.toFixed(2)} · drag to turn, wheel or + and - to come nearer`;
      } catch (error) {
        caption.textContent = error.message;
      }
    } while (again);
    busy = false;
    frame.classList.remove("busy");
  }

  function turn(azimuth, elevation, nearer = 1) {
    pose.azimuth = Math.max(-180, Math.min(180, pose.azimuth + azimuth));
    pose.elevation = Math.max(-60, Math.min(60, pose.elevation + elevation));
    pose.distance = Math.max(0.2, Math.min(4, pose.distance * nearer));
    draw();
  }
  frame.addEventListener("pointerdown", (event) => frame.setPointerCapture(event.pointerId));
  frame.addEventListener("pointermove", (event) => {
    if (event.buttons && (event.movementX || event.movementY)) turn(-event.movementX * 0.25, event.movementY * 0.25);
  });
  frame.addEventListener("wheel", (event) => { event.preventDefault(); turn(0, 0, event.deltaY > 0 ? 1.08 : 1 / 1.08); }, { passive: false });
  frame.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5], "+": [0, 0, 1 / 1.1], "-": [0, 0, 1.1] }[event.key];
    if (step) { turn(...step); event.preventDefault(); }
  });
  choice.addEventListener("change", draw);

  let known = "";
  return {
    root,
    update(rounds) {
      if (rounds.length === 0 || known === String(rounds)) return;
      known = String(rounds);
      choice.replaceChildren(h("option", { value: "" }, "delivered or last"), ...rounds.map((round) => h("option", { value: round }, String(round))));
      root.hidden = false;
      draw();
    },
  };
}
