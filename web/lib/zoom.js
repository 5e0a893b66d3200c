// Zoom and visible part of a view's pictures, the same for all.

/** Largest zoom; beyond it only pixels are visible. */
const MOST = 8;

/**
 * `scale`, at least 1, and the shift of a picture's corner as a share of its frame, so that frames
 * of any size show the same part. `follow` calls back at once and after each change.
 */
export function zoom() {
  let [scale, x, y] = [1, 0, 0];
  const followers = [];

  function place(to, left, top) {
    const before = [scale, x, y].join();
    scale = Math.min(MOST, Math.max(1, to));
    // The picture always fills its frame.
    x = Math.min(0, Math.max(1 - scale, left));
    y = Math.min(0, Math.max(1 - scale, top));
    if (before === [scale, x, y].join()) return false;
    for (const follower of followers) follower();
    return true;
  }

  return {
    scale: () => scale,
    transform: () => `translate(${100 * x}%, ${100 * y}%) scale(${scale})`,
    /** Zooms about a point of the frame, else its middle; returns whether anything changed. */
    by(factor, px = 0.5, py = 0.5) {
      const to = Math.min(MOST, Math.max(1, scale * factor));
      return place(to, px - ((px - x) * to) / scale, py - ((py - y) * to) / scale);
    },
    pan: (dx, dy) => place(scale, x + dx, y + dy),
    reset: () => place(1, 0, 0),
    follow(follower) {
      followers.push(follower);
      follower();
    },
  };
}
