// How far a picture is enlarged, and which part of it is seen.

/** Enlarged by more, one sees pixels only. */
const MOST = 8;

/** `scale` from 1 on, and the shift of the picture's corner, px. */
export function zoom(frame, changed) {
  let [scale, x, y] = [1, 0, 0];

  function place(to, left, top) {
    const { clientWidth: width, clientHeight: height } = frame;
    const before = [scale, x, y].join();
    scale = Math.min(MOST, Math.max(1, to));
    // The picture always fills its frame.
    x = Math.min(0, Math.max(width * (1 - scale), left));
    y = Math.min(0, Math.max(height * (1 - scale), top));
    if (before === [scale, x, y].join()) return false;
    changed();
    return true;
  }

  return {
    scale: () => scale,
    transform: () => `translate(${x}px, ${y}px) scale(${scale})`,
    /** By a factor around a point of the frame, its middle when absent; whether anything changed. */
    by(factor, px = frame.clientWidth / 2, py = frame.clientHeight / 2) {
      const to = Math.min(MOST, Math.max(1, scale * factor));
      return place(to, px - ((px - x) * to) / scale, py - ((py - y) * to) / scale);
    },
    pan: (dx, dy) => place(scale, x + dx, y + dy),
    reset: () => place(1, 0, 0),
  };
}
