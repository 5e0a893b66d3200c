// Two overlaid pictures with a bar between them, zoomed together.

import { h } from "./dom.js";
import { at, gestures, zoomKey } from "./gestures.js";
import { gains, values } from "./light.js";
import { zoom } from "./zoom.js";

/** Height limit of the comparison, as a share of the window's. */
const TALLEST = 0.8;
/** Smaller pictures are enlarged to this width, px. */
const NARROWEST = 420;
/** A press this close to the bar drags the bar, also when zoomed, px. */
const GRIP = 24;
const STEP = 0.05;
const IN = 1.5;
/** From this zoom on, pixels are shown unsmoothed. */
export const PIXELS = 4;
/** Two presses within this are a double click, ms. */
const DOUBLE = 500;

/**
 * `{ root, tools, view, lit(follower), show(a, b) }`: `tools` are its buttons, `view` is its zoom,
 * and `lit` calls its follower with whether all pictures are to be equally bright.
 */
export function split() {
  const below = picture("below");
  const top = picture("top");
  const bar = h("div", { class: "bar" });
  const [left, right] = [h("span", { class: "left" }), h("span", { class: "right" })];
  const root = h("div", { class: "compare", tabIndex: 0, role: "slider", "aria-label": "Comparison", "aria-valuemin": "0", "aria-valuemax": "100" },
    below.root, top.root, bar, left, right);
  const equal = h("input", { type: "checkbox" });
  const light = h("span", { class: "hint", role: "status" });
  const view = zoom();
  const { isPinching } = gestures(root, view, () => view.scale() > 1);
  const followers = [];
  let [share, drag] = [0.5, null];
  // Whether a side shows a picture whose brightness has a meaning.
  let isFixed = false;
  // The bar's position before the presses of a double click moved it.
  let before = { share, at: 0 };

  function place(value) {
    share = Math.min(1, Math.max(0, value));
    top.root.style.clipPath = `inset(0 ${100 * (1 - share)}% 0 0)`;
    bar.style.left = `${100 * share}%`;
    const percent = Math.round(100 * share);
    root.setAttribute("aria-valuenow", percent);
    root.setAttribute("aria-valuetext", `${percent} % ${left.textContent}, the rest ${right.textContent}`);
  }

  const level = h("span", { class: "soft" });
  const [nearer, farther, whole] = [["+", "Zoom in", () => view.by(IN)], ["−", "Zoom out", () => view.by(1 / IN)], ["Fit", "Fit picture", view.reset]]
    .map(([text, label, onclick]) => h("button", { type: "button", "aria-label": label, title: label, onclick }, text));

  function draw() {
    const scale = view.scale();
    for (const { image } of [below, top]) {
      image.style.transform = view.transform();
      image.classList.toggle("pixels", scale >= PIXELS);
    }
    root.classList.toggle("enlarged", scale > 1);
    level.textContent = `${scale.toFixed(1)} ×`;
    farther.disabled = scale === 1;
    whole.disabled = scale === 1;
  }

  function balance() {
    const ready = !isFixed && [top, below].every(({ image }) => image.complete && image.naturalWidth > 0);
    const [a, b] = equal.checked && ready ? gains(values(top.image), values(below.image)) : [1, 1];
    const brightened = (gain) => (gain > 1 ? `brightness(${gain.toFixed(3)})` : "");
    top.image.style.filter = brightened(a);
    below.image.style.filter = brightened(b);
    const [name, gain] = a > 1 ? [left.textContent, a] : [right.textContent, b];
    light.textContent = !equal.checked ? "" : isFixed ? "Difference and depth pictures are not brightened." : gain > 1.01
      ? `${name} is brightened × ${gain.toFixed(1)} to match the other side; its noise is amplified as much.` : "Both sides already have the same mean brightness.";
  }
  equal.addEventListener("change", () => {
    balance();
    for (const follower of followers) follower(equal.checked);
  });

  root.addEventListener("pointerdown", (event) => {
    const [x, y] = at(root, event);
    if (event.timeStamp - before.at > DOUBLE) before = { share, at: event.timeStamp };
    root.setPointerCapture(event.pointerId);
    if (isPinching()) { place(before.share); return; }
    const pans = view.scale() > 1 && Math.abs(x - share) * root.clientWidth > GRIP;
    drag = pans ? [x, y] : null;
    if (!pans) place(x);
  });
  root.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    const [x, y] = at(root, event);
    // Two fingers move the picture; a remaining one starts a drag where it is.
    if (isPinching()) { drag = [x, y]; return; }
    if (!drag) { place(x); return; }
    view.pan(x - drag[0], y - drag[1]);
    drag = [x, y];
  });
  root.addEventListener("dblclick", (event) => {
    const [x, y] = at(root, event);
    place(before.share);
    if (view.scale() > 1) view.reset();
    else view.by(IN * IN, x, y);
  });
  root.addEventListener("keydown", (event) => {
    if (zoomKey(event, view) || event.ctrlKey || event.metaKey || event.altKey) return;
    const keys = { Home: 0, End: 1, ArrowLeft: share - STEP, ArrowRight: share + STEP };
    if (keys[event.key] === undefined) return;
    place(keys[event.key]);
    event.preventDefault();
  });
  for (const { image } of [below, top]) image.addEventListener("load", balance);
  // Pictures have their own size; tall ones are fitted to the window.
  below.image.addEventListener("load", () => {
    const { naturalWidth: width, naturalHeight: height } = below.image;
    root.style.maxWidth = `${Math.round(Math.min(Math.max(width, NARROWEST), (TALLEST * innerHeight * width) / height))}px`;
  });
  place(0.5);
  view.follow(draw);
  return {
    root,
    view,
    lit(follower) { followers.push(follower); },
    tools: h("div", { class: "row tools" }, farther, nearer, whole, level, h("label", { class: "check" }, equal, "Match brightness"), light),
    show(a, b) {
      isFixed = [a, b].some((one) => one.isFixed);
      top.show(a);
      below.show(b);
      left.textContent = a.label;
      right.textContent = b.label;
      place(share);
      balance();
    },
  };
}

function picture(style) {
  const image = h("img", { alt: "", draggable: false });
  return {
    image,
    root: h("div", { class: `half ${style}` }, image),
    show({ url }) { if (image.getAttribute("src") !== url) image.src = url; },
  };
}
