// The row of buttons below the scene.

import { h } from "../lib/dom.js";
import { slider } from "./slider.js";

/**
 * `does` has `jump(index)`, `reset`, `lines(isOn)`, `exposure` (null if unsupported),
 * `lens(degrees)` with null for the camera's own, `round(scene)`, `picture`, `close`; `stage` is
 * the element for full screen. `isBest` says whether `reset` goes to the best view. `further` are
 * `{ choices, rows }` of further tools. Returns
 * `{ root, at(index), isOn(), ev(), lens(degrees), speed(), scenes(list, current), say(words) }`.
 */
export function sceneTools(cameras, stage, isBest, further, does) {
  const press = (text, onclick, label = text) =>
    h("button", { type: "button", "aria-label": label, title: label, onclick }, text);
  const jump = () => does.jump(Number(choice.value));
  const choice = h("select", { "aria-label": "Photograph", onchange: jump },
    h("option", { value: "-1" }, "Free view"),
    cameras.map(({ name, split }, i) => h("option", { value: String(i) },
      split === "held_out" ? `${name} (held out)` : name)));
  let [last, wasShown] = [0, false];
  const step = (by) => () => does.jump((last + by + cameras.length) % cameras.length);
  const lines = h("input", { type: "checkbox", onchange: () => does.lines(lines.checked) });
  const exposure = slider("Exposure", "exposure", { min: -3, max: 3, step: 0.25, first: 0, words: signed, changed: does.exposure });
  exposure.root.hidden = !does.exposure;
  const lens = slider("Field of view", "lens", { min: 15, max: 110, step: 1, first: 50, words: (degrees) => `${degrees}° view`, changed: does.lens });
  // For keys; touch has its own speed.
  const speed = slider("Speed", "speed", { min: -3, max: 3, step: 1, first: 0, words: (power) => `${2 ** power}× speed`, changed: null });
  const rounds = roundSlider(does.round);
  const words = h("p", { class: "hint", role: "status" });
  const picture = press("Save PNG", async () => {
    picture.disabled = true;
    await does.picture();
    picture.disabled = false;
  }, "Save PNG of this view, rendered by the server");
  const full = press("Full screen", () => wide(stage));
  full.hidden = !document.fullscreenEnabled;
  const root = h("div", { class: "controls" },
    h("div", { class: "row tools" },
      h("div", { class: "row joint" }, press("‹", step(-1), "Previous photograph"), choice,
        press("›", step(1), "Next photograph")),
      isBest ? press("Best view", does.reset, "Back to the best view")
        : press("Reset", does.reset, "Reset to the first view"),
      h("label", { class: "check" }, lines, "Cameras"), further.choices, exposure.root,
      lens.root, speed.root, rounds.root,
      h("div", { class: "row push ends" }, picture, full,
        press("Close", does.close, "Close the 3D view"))),
    further.rows, words);
  return {
    root,
    /** The view is at a photograph's camera, or with -1 at none. */
    at(index) {
      if (index >= 0) last = index;
      choice.value = String(index);
    },
    isOn: () => lines.checked,
    /** Stops brighter than the scene. */
    ev: () => (does.exposure ? exposure.value() : 0),
    /** Sets the slider to the camera's own field of view, degrees. */
    lens: (degrees) => lens.set(degrees),
    /** Walking speed, as a factor. */
    speed: () => 2 ** speed.value(),
    scenes(list, current) {
      // The server renders scenes, not points. The cameras are half of what the points show.
      picture.hidden = current.isPoints === true;
      if (current.isPoints && !wasShown) lines.checked = true;
      wasShown = true;
      rounds.set(list, current);
    },
    say: (text) => { words.textContent = text; },
  };
}

function wide(stage) {
  if (document.fullscreenElement) document.exitFullscreen();
  // Some frames and settings refuse it; the button then does nothing.
  else stage.requestFullscreen().catch(() => {});
}

const signed = (value) => `${value > 0 ? "+" : ""}${value.toFixed(2).replace("-", "−")} EV`;

/** Chooses the round of the scene; hidden if there is only one. */
function roundSlider(chosen) {
  const input = h("input", { type: "range", min: "0", step: "1", "aria-label": "Round" });
  const label = h("span", {});
  const root = h("label", { class: "check rounds" }, label, input);
  let list = [];
  const say = () => {
    const { round, isDelivered, isPoints } = list[input.value];
    label.textContent = isPoints ? "Sparse points" : `Round ${round}${isDelivered ? ", delivered" : ""}`;
    input.setAttribute("aria-valuetext", label.textContent);
  };
  input.addEventListener("input", say);
  input.addEventListener("change", () => chosen(list[input.value]));
  return {
    root,
    set(scenes, current) {
      list = scenes;
      root.hidden = scenes.length < 2;
      input.max = String(scenes.length - 1);
      input.value = String(Math.max(0, scenes.findIndex(({ url }) => url === current.url)));
      say();
    },
  };
}
