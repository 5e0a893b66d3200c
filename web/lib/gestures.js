// Zooms the content of a frame by wheel and two fingers.

/** Factor per turn of the wheel. */
const TURN = 1.2;

/** Position of an event in a frame, as shares of its width and height. */
export function at(frame, event) {
  const box = frame.getBoundingClientRect();
  return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
}

/**
 * Lets wheel and pinch on `frame` move `view`. The wheel scrolls the page unless Ctrl is held, a
 * click came before, or `isOwn()`. `isPinching()` returns whether two fingers are on it.
 */
export function gestures(frame, view, isOwn = () => false) {
  const fingers = new Map();
  let isHeld = false;

  frame.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey && !isHeld && !isOwn()) return;
      const changed = view.by(event.deltaY > 0 ? 1 / TURN : TURN, ...at(frame, event));
      if (changed || event.ctrlKey) event.preventDefault();
    },
    { passive: false },
  );

  frame.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse") isHeld = true;
    else fingers.set(event.pointerId, at(frame, event));
  });
  frame.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const before = pair();
    fingers.set(event.pointerId, at(frame, event));
    const now = pair();
    if (!before || !now) return;
    view.by(now.apart / before.apart, ...before.middle);
    view.pan(now.middle[0] - before.middle[0], now.middle[1] - before.middle[1]);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    frame.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  frame.addEventListener("pointerleave", (event) => {
    if (!event.buttons) isHeld = false;
  });
  // Otherwise the browser takes two fingers for scrolling.
  frame.addEventListener(
    "touchmove",
    (event) => {
      if (event.touches.length > 1 && event.cancelable) event.preventDefault();
    },
    { passive: false },
  );

  /** Distance and centre of two fingers. */
  function pair() {
    if (fingers.size !== 2) return null;
    const [[ax, ay], [bx, by]] = fingers.values();
    return {
      apart: Math.max(0.02, Math.hypot(ax - bx, ay - by)),
      middle: [(ax + bx) / 2, (ay + by) / 2],
    };
  }
  return { isPinching: () => fingers.size > 1 };
}

/** Handles + − 0 and Shift with arrows in pictures; returns whether the key was one of them. */
export function zoomKey(event, view) {
  const [step, enlarge] = [0.12, 1.5];
  const to = {
    ArrowLeft: [step, 0],
    ArrowRight: [-step, 0],
    ArrowUp: [0, step],
    ArrowDown: [0, -step],
  }[event.key];
  if (event.ctrlKey || event.metaKey || event.altKey) return false;
  if (event.key === "+" || event.key === "=") view.by(enlarge);
  else if (event.key === "-") view.by(1 / enlarge);
  else if (event.key === "0") view.reset();
  else if (event.shiftKey && to) view.pan(...to);
  else return false;
  event.preventDefault();
  return true;
}
