// A novel view: drag to turn, + and - to come nearer.

import { h } from "../lib/dom.js";

const NEAREST = 0.2;
const FARTHEST = 4;
const MOVES = [["Turn left", "←", [-10, 0]], ["Turn right", "→", [10, 0]], ["Up", "↑", [0, 10]], ["Down", "↓", [0, -10]],
  ["Move closer", "+", [0, 0, 1 / 1.2]], ["Move away", "−", [0, 0, 1.2]]];
const KEYS = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5], "+": [0, 0, 1 / 1.1], "=": [0, 0, 1 / 1.1], "-": [0, 0, 1.1] };

export function novelView(job) {
  const image = h("img", { alt: "Rendered view", draggable: false });
  const caption = h("p", { class: "hint", role: "status" });
  const frame = h("div", { class: "view", tabIndex: 0, role: "group", "aria-label": "Novel view: use the arrow keys to turn" }, image);
  const choice = h("select", { "aria-label": "Round" });
  const tools = h("div", { class: "row tools" }, MOVES.map(([label, text, move]) =>
    h("button", { type: "button", "aria-label": label, title: label, onclick: () => turn(...move) }, text)),
    h("button", { type: "button", onclick: home }, "Reset"));
  const root = h("section", { hidden: true },
    h("div", { class: "row" }, h("h2", {}, "Novel view"), h("label", { class: "push" }, "Round", choice)),
    frame, tools, caption,
    h("p", { class: "hint" }, "The server renders this view, so it works on any machine. Drag or use the arrow keys to turn. Use + and −, Ctrl and the wheel, or the wheel after a click to move closer or away."));
  const pose = { azimuth: 0, elevation: 0, distance: 1 };
  let [busy, again, shown] = [false, false, ""];
  // The wheel scrolls the page until a click into the view, and again once the pointer leaves it.
  let isHeld = false;

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
        const response = await fetch(`v1/jobs/${job}/render?${query}`);
        if (!response.ok) throw new Error((await response.json()).detail);
        const url = URL.createObjectURL(await response.blob());
        image.src = url;
        await image.decode().catch(() => {});
        if (shown) URL.revokeObjectURL(shown);
        shown = url;
        caption.textContent = `azimuth ${pose.azimuth.toFixed(0)}°, elevation ${pose.elevation.toFixed(0)}°, distance ${pose.distance.toFixed(2)}`;
      } catch (error) {
        caption.textContent = error.message;
      }
    } while (again);
    busy = false;
    frame.classList.remove("busy");
  }

  /** Returns whether the view moved; at its limits it does not. */
  function turn(azimuth, elevation, nearer = 1) {
    const before = JSON.stringify(pose);
    pose.azimuth = Math.max(-180, Math.min(180, pose.azimuth + azimuth));
    pose.elevation = Math.max(-60, Math.min(60, pose.elevation + elevation));
    pose.distance = Math.max(NEAREST, Math.min(FARTHEST, pose.distance * nearer));
    if (before === JSON.stringify(pose)) return false;
    draw();
    return true;
  }
  function home() {
    Object.assign(pose, { azimuth: 0, elevation: 0, distance: 1 });
    draw();
  }
  frame.addEventListener("pointerdown", (event) => { isHeld = true; frame.setPointerCapture(event.pointerId); });
  frame.addEventListener("pointerleave", (event) => { if (!event.buttons) isHeld = false; });
  frame.addEventListener("pointermove", (event) => {
    if (event.buttons && (event.movementX || event.movementY)) turn(-event.movementX * 0.25, event.movementY * 0.25);
  });
  frame.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !isHeld) return;
    if (turn(0, 0, event.deltaY > 0 ? 1.08 : 1 / 1.08) || event.ctrlKey) event.preventDefault();
  }, { passive: false });
  frame.addEventListener("keydown", (event) => {
    const step = KEYS[event.key];
    if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
    turn(...step);
    event.preventDefault();
  });
  choice.addEventListener("change", draw);

  let known = "";
  return {
    root,
    update(rounds) {
      if (rounds.length === 0 || known === String(rounds)) return;
      known = String(rounds);
      const before = choice.value;
      choice.replaceChildren(h("option", { value: "" }, "delivered or latest"),
        ...rounds.map((round) => h("option", { value: round, selected: String(round) === before }, String(round))));
      root.hidden = false;
      draw();
    },
  };
}
