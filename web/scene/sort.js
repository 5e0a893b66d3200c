// Sorts Gaussians for blending, from back to front.

import { GEOMETRY } from "./ply.js";

/** Values of half a key. */
const DIGITS = 1 << 16;

/**
 * Sorts the Gaussians of `geometry` for each view. The returned function takes the third row of
 * world to camera and the near plane, and returns the indexes of all beyond it, farthest first. The
 * bits of a positive float grow with it, so a counting sort over their lower and then their upper
 * half is exact. Equal depths are in the server's blending order, the first of them in front.
 */
export function sorter(geometry) {
  const count = geometry.length / GEOMETRY;
  const depths = new Float32Array(count);
  const keys = new Uint32Array(depths.buffer);
  const [beyond, half] = [new Uint32Array(count), new Uint32Array(count)];
  const [low, high] = [new Uint32Array(DIGITS), new Uint32Array(DIGITS)];

  return ([x, y, z, shift], near) => {
    low.fill(0);
    high.fill(0);
    let n = 0;
    for (let i = 0; i < count; i++) {
      const at = GEOMETRY * i;
      depths[i] = x * geometry[at] + y * geometry[at + 1] + z * geometry[at + 2] + shift;
      if (!(depths[i] >= near) || geometry[at + 3] === 0) continue;
      beyond[n++] = i;
      low[keys[i] & 0xffff]++;
      high[keys[i] >>> 16]++;
    }
    starts(low);
    starts(high);
    for (let k = 0; k < n; k++) half[low[keys[beyond[k]] & 0xffff]++] = beyond[k];
    const order = new Uint32Array(n);
    for (let k = 0; k < n; k++) order[n - 1 - high[keys[half[k]] >>> 16]++] = half[k];
    return order;
  };
}

/** Turns counts into the start of each value. */
function starts(counts) {
  let sum = 0;
  for (let k = 0; k < DIGITS; k++) {
    const many = counts[k];
    counts[k] = sum;
    sum += many;
  }
}
