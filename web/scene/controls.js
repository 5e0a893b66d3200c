// How one moves: pointer, touch, wheel and keys become steps of the camera.

import { looked, neared, orbited, risen, walked } from "./camera.js";

/** Radians a pixel that is dragged. */
const TURN = 0.005;
/** Radians, and radii of the photographers' ring, a second that a key is held. */
const TURN_SPEED = 1;
const WALK_SPEED = 0.6;
/** With Shift, times that. */
const RUN = 3;
/** By a turn of the wheel of so many px the distance halves. */
const HALVING = 500;
/** A press that moved by less is a click, px. */
const CLICK = 4;
/** Lines and pages of a wheel that does not count pixels, px. */
const UNITS = [1, 32, 400];

/** By physical key, so that they lie as a hand does whatever the keyboard says. */
const WALKS = {
  KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0],
};
const RISES = { KeyE: 1, KeyQ: -1 };
const LOOKS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const NEARS = { Equal: -1, NumpadAdd: -1, Minus: 1, NumpadSubtract: 1 };
const isMoving = (code) => [WALKS, RISES, LOOKS, NEARS].some((keys) => code in keys);

/**
 * Listens on `frame`. `camera` has `pose`, `surroundings`, `focal()` in CSS px, `speed()`, `moved(pose)` for
 * what was done at once, `wake()` for keys that are held, and `clicked(x, y)`. The wheel and a
 * finger that moves up or down are the page's as long as the frame has no focus.
 */
export function controls(frame, camera) {
  const pointers = new Map();
  const keys = new Set();
  const ended = new AbortController();
  const on = (name, does, further = {}) =>
    frame.addEventListener(name, does, { signal: ended.signal, ...further });
  let [travelled, runs] = [0, false];
  const change = (move, ...by) => camera.moved(move(camera.pose, camera.surroundings, ...by));
  const pan = (dx, dy) => {
    const scale = camera.pose.distance / camera.focal();
    camera.moved(walked(camera.pose, [-dx * scale, -dy * scale, 0]));
  };

  on("pointerdown", (event) => {
    if (event.button > 2) return;
    travelled = 0;
    frame.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    // A press with the right button would not give the focus.
    if (event.pointerType === "mouse") frame.focus({ preventScroll: true });
  });
  on("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    travelled += Math.hypot(dx, dy);
    if (pointers.size === 2) pinch(event, dx, dy);
    else if (event.buttons & 6 || event.shiftKey) pan(dx, dy);
    else change(orbited, -dx * TURN, dy * TURN);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });

  /** Two fingers shift by half of what each moves, and come nearer as they part. */
  function pinch(event, dx, dy) {
    const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
    const apart = ([x, y]) => Math.max(1, Math.hypot(x - other[0], y - other[1]));
    pan(dx / 2, dy / 2);
    change(neared, apart(pointers.get(event.pointerId)) / apart([event.clientX, event.clientY]));
  }

  on("pointerup", (event) => {
    if (!pointers.delete(event.pointerId) || travelled > CLICK) return;
    frame.focus({ preventScroll: true });
    const box = frame.getBoundingClientRect();
    camera.clicked(event.clientX - box.left, event.clientY - box.top);
  });
  on("pointercancel", (event) => pointers.delete(event.pointerId));
  on("contextmenu", (event) => event.preventDefault());
  on("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== frame) return;
    event.preventDefault();
    const pixels = event.deltaY * UNITS[event.deltaMode];
    change(neared, 2 ** (Math.max(-HALVING, Math.min(HALVING, pixels)) / HALVING));
  }, { passive: false });
  on("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Escape") frame.blur();
    if (!isMoving(event.code)) return;
    event.preventDefault();
    keys.add(event.code);
    runs = event.shiftKey;
    camera.wake();
  });
  on("keyup", (event) => {
    keys.delete(event.code);
    runs = event.shiftKey;
  });
  on("blur", () => keys.clear());

  return {
    /** Whether a key is held that moves. */
    isHeld: () => keys.size > 0,
    /** Where the held keys lead within `seconds`. */
    held(seconds) {
      const [angle, way] = [TURN_SPEED * seconds, camera.speed() * WALK_SPEED * seconds * (runs ? RUN : 1)];
      const { surroundings } = camera;
      let { pose } = camera;
      for (const code of keys) {
        const step = way * surroundings.radius;
        if (WALKS[code]) pose = walked(pose, WALKS[code].map((part) => part * step));
        if (RISES[code]) pose = risen(pose, surroundings, RISES[code] * step);
        if (LOOKS[code]) pose = looked(pose, surroundings, ...LOOKS[code].map((a) => a * angle));
        if (NEARS[code]) pose = neared(pose, surroundings, 2 ** (NEARS[code] * way));
      }
      return pose;
    },
    leave: () => ended.abort(),
  };
}
