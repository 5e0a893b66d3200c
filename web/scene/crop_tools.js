// The controls of the crop that is drawn in the scene.

import { h } from "../lib/dom.js";
import {
  cropWithin, firstCrop, outline, reshaped, roundedLength, roundedPoint, usualReach,
} from "./crop.js";
import { drawLines } from "./lines.js";
import { slider } from "./slider.js";

/** Steps of a slider that double a size, and steps to either end. */
const OCTAVE = 12;
const FARTHEST = 4 * OCTAVE;
/** @type {[string, number]} */
const LINE = ["#7ee2a8", 1.6];
const NAMES = { sphere: ["Radius"], box: ["Width", "Height", "Depth"] };
const AIM = "Choose the middle of the crop";

/**
 * `shaping` holds the crop; `ask(what)` is a promise of a point of the drawn scene that the user
 * picks, or of `null`. Returns `{ choice, row, show(), drawn(), draw(context, pose, k, near) }`:
 * `show` takes over the crop of `shaping`, `drawn` is the crop as drawn in `world`.
 */
export function cropTools(shaping, surroundings, world, ask) {
  let last = shaping.now.crop ?? firstCrop(surroundings, world);
  const usual = usualReach(surroundings, world);
  const nudge = 10 ** Math.floor(Math.log10(usual / 5));
  const change = (crop) => shaping.change({ crop: { ...shaping.now.crop, ...crop } });
  const choose = () => shaping.change({
    crop: select.value === "" ? null : reshaped(last, select.value),
  });
  const select = h("select", { "aria-label": "Crop", onchange: choose },
    [["", "No crop"], ["sphere", "Crop to a sphere"], ["box", "Crop to a box"]]
      .map(([value, words]) => h("option", { value }, words)));
  const place = h("button", {
    type: "button", title: "Choose the middle of the crop in the picture",
    onclick: async () => {
      const point = await ask(AIM);
      if (!point || !shaping.now.crop) return;
      const { scale, offset } = world;
      change({ centre: roundedPoint(point.map((value, k) => value / scale + offset[k]), usual) });
    },
  }, "Place");
  const axes = ["X", "Y", "Z"].map((name, axis) => {
    const input = h("input", {
      type: "number", step: String(nudge), "aria-label": `${name} of the crop's middle`,
      oninput: () => {
        if (!Number.isFinite(input.valueAsNumber)) return;
        change({ centre: shaping.now.crop.centre.with(axis, input.valueAsNumber) });
      },
      // Whatever is no number becomes the last one again.
      onchange: () => show(),
    });
    return { input, root: h("label", { class: "check axis" }, name, input) };
  });
  const sizes = h("div", { class: "row sizes" });
  let [shape, sliders] = ["", []];
  const row = h("div", { class: "row shapes", hidden: true },
    place, axes.map(({ root }) => root), sizes);

  const whole = () => (shape === "box" ? 2 * usual : usual);
  const sizeAt = (step) => roundedLength(whole() * 2 ** (step / OCTAVE));

  function reshape(now) {
    shape = now;
    sliders = NAMES[shape].map((name, k) => slider(name, "size", {
      min: -FARTHEST, max: FARTHEST, step: 1, first: 0,
      words: () => `${name} ${shaping.now.crop.size[k]}`,
      changed: (step) => change({
        size: shaping.now.crop.size.with(k, sizeAt(step ?? 0)),
      }),
    }));
    sizes.replaceChildren(...sliders.map(({ root }) => root));
  }

  function show() {
    const { isOffered, crop } = shaping.now;
    select.hidden = !isOffered;
    row.hidden = !crop;
    select.value = crop?.shape ?? "";
    if (!crop) return;
    last = crop;
    if (shape !== crop.shape) reshape(crop.shape);
    crop.size.forEach((size, k) => sliders[k].set(Math.round(OCTAVE * Math.log2(size / whole()))));
    axes.forEach(({ input }, k) => {
      // What is being typed stays.
      if (input.valueAsNumber !== crop.centre[k]) input.value = String(crop.centre[k]);
    });
  }

  const drawn = () => shaping.now.crop && cropWithin(shaping.now.crop, world);
  show();
  return {
    choice: select,
    row,
    show,
    drawn,
    draw(context, pose, k, near) {
      const crop = drawn();
      if (crop) drawLines(context, pose, k, outline(crop), near, LINE);
    },
  };
}
