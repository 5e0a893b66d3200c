// Two pictures on top of each other with a bar between them, enlarged together.

import { h } from "./dom.js";
import { gains, values } from "./light.js";
import { zoom } from "./zoom.js";

/** Of the comparison, px. */
const LARGEST_HEIGHT = 560;
/** So close to the bar one takes the bar, also in an enlarged picture, px. */
const GRIP = 24;
const STEP = 0.05;
const PAN = 60;
const IN = 1.5;
/** Enlarged so far, one wants to see the pixels as they are. */
const PIXELS = 4;
/** Two presses within this are a double click, ms. */
const DOUBLE = 500;

/** `{ root, tools, show(a, b) }`: `tools` are its buttons. */
export function split() {
  const below = picture("below");
  const top = picture("top");
  const bar = h("div", { class: "bar" });
  const [left, right] = [h("span", { class: "left" }), h("span", { class: "right" })];
  const root = h("div", { class: "compare", tabIndex: 0, role: "slider", "aria-label": "comparison", "aria-valuemin": "0", "aria-valuemax": "100" },
    below.root, top.root, bar, left, right);
  const equal = h("input", { type: "checkbox" });
  const light = h("span", { class: "hint", role: "status" });
  const view = zoom(root, draw);
  let [share, drag] = [0.5, null];
  // Where the bar was before the presses that become a double click moved it.
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
  const [nearer, farther, whole] = [["+", "Enlarge", () => view.by(IN)], ["−", "Reduce", () => view.by(1 / IN)], ["Whole", "Whole picture", view.reset]]
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
    const ready = [top, below].every(({ image }) => image.complete && image.naturalWidth > 0);
    const [a, b] = equal.checked && ready ? gains(values(top.image), values(below.image)) : [1, 1];
    for (const [one, gain] of [[top, a], [below, b]]) one.image.style.filter = gain > 1 ? `brightness(${gain.toFixed(3)})` : "";
    const [name, gain] = a > 1 ? [left.textContent, a] : [right.textContent, b];
    light.textContent = !equal.checked ? "" : gain > 1.01
      ? `${name} × ${gain.toFixed(1)}, so that both have the same mean. Its noise grows as much.` : "Both have the same mean as they are.";
  }
  equal.addEventListener("change", balance);

  const point = (event) => {
    const box = root.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top, box.width];
  };
  root.addEventListener("pointerdown", (event) => {
    const [x, y, width] = point(event);
    if (event.timeStamp - before.at > DOUBLE) before = { share, at: event.timeStamp };
    root.setPointerCapture(event.pointerId);
    const pans = view.scale() > 1 && Math.abs(x - share * width) > GRIP;
    drag = pans ? [x, y] : null;
    if (!pans) place(x / width);
  });
  root.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    const [x, y, width] = point(event);
    if (!drag) { place(x / width); return; }
    view.pan(x - drag[0], y - drag[1]);
    drag = [x, y];
  });
  root.addEventListener("dblclick", (event) => {
    const [x, y] = point(event);
    place(before.share);
    if (view.scale() > 1) view.reset();
    else view.by(IN * IN, x, y);
  });
  root.addEventListener("wheel", (event) => {
    // The wheel is the page's, unless it is meant for the picture and still does something there.
    if (!event.ctrlKey && view.scale() === 1) return;
    const [x, y] = point(event);
    if (view.by(event.deltaY > 0 ? 1 / 1.2 : 1.2, x, y) || event.ctrlKey) event.preventDefault();
  }, { passive: false });
  root.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const [dx, dy] = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    const keys = { Home: () => place(0), End: () => place(1), "+": () => view.by(IN), "=": () => view.by(IN), "-": () => view.by(1 / IN), 0: view.reset };
    if (keys[event.key]) keys[event.key]();
    else if (event.shiftKey && (dx || dy)) view.pan(dx * PAN, dy * PAN);
    else if (dx) place(share - dx * STEP);
    else return;
    event.preventDefault();
  });
  for (const { image } of [below, top]) image.addEventListener("load", balance);
  // Small pictures are enlarged, tall ones kept on the screen.
  below.image.addEventListener("load", () => {
    root.style.maxWidth = `${Math.min(720, (LARGEST_HEIGHT * below.image.naturalWidth) / below.image.naturalHeight)}px`;
  });
  place(0.5);
  draw();
  return {
    root,
    tools: h("div", { class: "row tools" }, farther, nearer, whole, level, h("label", { class: "check" }, equal, "Equal brightness"), light),
    show(a, b) {
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
