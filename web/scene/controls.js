// Navigation: turns pointer, touch, wheel and keys into camera movements.

import { looked, neared, orbited, risen, walked } from "./camera.js";

/** Radians per pixel dragged. */
const TURN = 0.005;
/** Radians, and radii of the photographers' ring, per second of a held key. */
const TURN_SPEED = 1;
const WALK_SPEED = 0.6;
/** Speed factor of Shift. */
const RUN = 3;
/** Turn of the wheel that halves the distance, px. */
const HALVING = 500;
/** A press that moved by less is a click, px. */
const CLICK = 4;
/** Pixels per unit of the wheel: pixel, line, page. */
const UNITS = [1, 32, 400];

/** By physical key, so that they lie under the hand with every keyboard layout. */
const WALKS = {
  KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0],
};
const RISES = { KeyE: 1, KeyQ: -1 };
const LOOKS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const NEARS = { Equal: -1, NumpadAdd: -1, Minus: 1, NumpadSubtract: 1 };
const isMoving = (code) => [WALKS, RISES, LOOKS, NEARS].some((keys) => code in keys);

/**
 * Listens on `frame`. `camera` has `pose`, `surroundings`, `focal()` in CSS px, `speed()`,
 * `moved(pose)` for immediate movements, `wake()` for held keys, `clicked(x, y)`, `entered()` for
 * Enter, and `escaped()`, which says whether it used Escape. While the frame has no focus, the
 * wheel and a vertical swipe scroll the page.
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
    // The right button would not set the focus by itself.
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

  /** Each of two fingers pans by half its movement; spreading them moves nearer. */
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
    if (event.key === "Escape" && !camera.escaped()) frame.blur();
    if (event.key === "Enter" && !event.repeat && event.target === frame) camera.entered();
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
    /** Whether a movement key is held. */
    isHeld: () => keys.size > 0,
    /** The pose after `seconds` of the held keys. */
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
