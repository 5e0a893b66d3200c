// The pictures of a view in a row, zoomed and brightened together.

import { h } from "./dom.js";
import { at, gestures, zoomKey } from "./gestures.js";
import { level, values } from "./light.js";
import { PIXELS } from "./split.js";

/** A press that moves farther is a drag, px. */
const DRAG = 4;

/**
 * One stop of the Tab key, arrow keys within. A press puts a picture on the side of `slider` chosen
 * above them, with Shift on the other: `chosen(side, key)`. A picture without `url` has `make()`,
 * which returns a promise of one and is called when the row comes near.
 */
export function thumbnails(chosen, slider) {
  const { view } = slider;
  let [side, isEqual, isNear] = ["left", false, false];
  let come;
  const near = new Promise((resolve) => {
    come = resolve;
  });
  const grid = h("div", { class: "shots", role: "group", "aria-label": "Pictures of the view" });
  const sides = ["left", "right"].map((name) =>
    h(
      "button",
      { type: "button", "aria-pressed": String(name === side), onclick: () => choose(name) },
      name,
    ),
  );
  const root = h(
    "div",
    {},
    h(
      "div",
      { class: "row sides", role: "group", "aria-label": "Side" },
      "Choose a picture for the",
      ...sides,
    ),
    grid,
  );
  const buttons = () => [...grid.querySelectorAll("button:not(:disabled)")];
  const images = () => [...grid.querySelectorAll("img")];

  function choose(name) {
    side = name;
    for (const button of sides)
      button.setAttribute("aria-pressed", String(button.textContent === name));
  }

  function shot(picture, i) {
    const image = h("img", {
      src: picture.url,
      alt: "",
      loading: isNear ? "eager" : "lazy",
      draggable: false,
    });
    const mark = h("span", { class: "mark" });
    const frame = h("span", { class: "frame" }, image);
    const button = h(
      "button",
      { type: "button", class: "shot", tabIndex: i === 0 ? 0 : -1, onclick: press },
      frame,
      h("span", { class: "caption" }, picture.label, " ", mark),
    );
    const miss = () => {
      button.disabled = true;
      button.classList.add("missing");
    };
    const dragged = drags(frame);
    function press(event) {
      if (dragged()) return;
      chosen(event.shiftKey === (side === "left") ? "right" : "left", picture.key);
    }
    gestures(frame, view);
    image.addEventListener("load", balance);
    image.addEventListener("error", miss);
    image.isFixed = picture.isFixed === true;
    if (picture.make) {
      near.then(() => image.isConnected && picture.make()).then((url) => {
        if (url && image.isConnected) image.src = url;
      }, miss);
    }
    const figure = h("figure", {}, button);
    figure.say = (words) => {
      mark.textContent = words;
      figure.classList.toggle("chosen", words !== "");
    };
    figure.key = picture.key;
    return figure;
  }

  /** Lets a mouse move a zoomed picture; returns whether the last press was such a move. */
  function drags(frame) {
    let [from, first, moved] = [null, null, false];
    frame.addEventListener("pointerdown", (event) => {
      moved = false;
      if (event.pointerType !== "mouse" || view.scale() === 1) return;
      first = [event.clientX, event.clientY];
      from = at(frame, event);
      frame.setPointerCapture(event.pointerId);
    });
    frame.addEventListener("pointermove", (event) => {
      if (!from || !event.buttons) return;
      moved ||= Math.hypot(event.clientX - first[0], event.clientY - first[1]) > DRAG;
      const to = at(frame, event);
      view.pan(to[0] - from[0], to[1] - from[1]);
      from = to;
    });
    frame.addEventListener("pointerup", () => {
      from = null;
    });
    return () => {
      const was = moved;
      moved = false;
      return was;
    };
  }

  function draw() {
    for (const image of images()) {
      image.style.transform = view.transform();
      image.classList.toggle("pixels", view.scale() >= PIXELS);
    }
  }

  /**
   * At equal brightness all get the mean of the brightest loaded picture, except those whose
   * brightness has a meaning.
   */
  function balance() {
    const isReady = (image) => image.complete && image.naturalWidth > 0 && !image.isFixed;
    const ready = images().filter(isReady);
    const gains = isEqual ? level(ready.map((image) => (image.light ??= values(image)))) : [];
    ready.forEach((image, i) => {
      image.style.filter = gains[i] > 1 ? `brightness(${gains[i].toFixed(3)})` : "";
    });
  }

  grid.addEventListener("keydown", (event) => {
    if (zoomKey(event, view)) return;
    const all = buttons();
    const place = all.indexOf(document.activeElement);
    const row = all.filter((one) => one.offsetTop === all[0].offsetTop).length;
    // In a single row, up and down also move along it.
    const columns = row === all.length ? 1 : row;
    const to = {
      ArrowLeft: place - 1,
      ArrowRight: place + 1,
      ArrowUp: place - columns,
      ArrowDown: place + columns,
      Home: 0,
      End: all.length - 1,
    }[event.key];
    if (place < 0 || to === undefined) return;
    event.preventDefault();
    if (!all[to]) return;
    all[place].tabIndex = -1;
    all[to].tabIndex = 0;
    all[to].focus();
  });
  // A row scrolled sideways is fetched as a whole, once it comes near.
  new IntersectionObserver(
    ([{ isIntersecting }]) => {
      if (!isIntersecting) return;
      isNear = true;
      come();
      for (const image of images()) image.loading = "eager";
    },
    { rootMargin: "400px" },
  ).observe(grid);
  view.follow(draw);
  slider.lit((equal) => {
    isEqual = equal;
    balance();
  });

  let known = "";
  return {
    root,
    fill(pictures) {
      // Unchanged pictures are not fetched again.
      const now = JSON.stringify(pictures);
      if (now === known) return;
      known = now;
      grid.replaceChildren(...pictures.map(shot));
      draw();
    },
    mark(left, right) {
      for (const figure of grid.children) {
        figure.say(
          [figure.key === left && "left", figure.key === right && "right"]
            .filter(Boolean)
            .join(", "),
        );
      }
    },
  };
}
