// The part of a scene to keep: a sphere, or a box along the axes of the poses' world.
//
// A crop is `{ shape: "sphere" | "box", centre, size }` in the world of the poses, in which `size`
// is `[radius]` or `[width, height, depth]`. As drawn it is `{ isBox, centre, half }`.

import { pointWithin } from "./world.js";

/** Share of the photographers' ring that a new crop reaches from its centre. */
const REACH = 0.5;
/** Digits of lengths; those of a centre are as fine. */
const DIGITS = 3;
/** Straight lines of a circle. */
const SIDES = 64;

/** A length with as many digits as one chooses by eye. */
export const roundedLength = (length) => Number(length.toPrecision(DIGITS));

/** A point, no finer than the last digit of `length`. */
export function roundedPoint(point, length) {
  const decimals = Math.max(0, DIGITS - 1 - Math.floor(Math.log10(length)));
  return point.map((value) => Number(value.toFixed(Math.min(decimals, 100))));
}

/** Half the size of a new crop, in the world of the poses. */
export const usualReach = ({ radius }, world) => roundedLength((REACH * radius) / world.scale);

/** The sphere around what the cameras look at. */
export function firstCrop(surroundings, world) {
  const reach = usualReach(surroundings, world);
  const centre = surroundings.centre.map((value, k) => value / world.scale + world.offset[k]);
  return { shape: "sphere", centre: roundedPoint(centre, reach), size: [reach] };
}

/** A crop of another shape around the same. */
export function reshaped(crop, shape) {
  if (crop.shape === shape) return crop;
  const half = shape === "box" ? crop.size[0] : Math.max(...crop.size) / 2;
  const size = shape === "box" ? Array(3).fill(roundedLength(2 * half)) : [roundedLength(half)];
  return { ...crop, shape, size };
}

/** A crop as drawn in `world`. */
export function cropWithin({ shape, centre, size }, world) {
  const isBox = shape === "box";
  const half = isBox ? size.map((side) => (side / 2) * world.scale)
    : Array(3).fill(size[0] * world.scale);
  return { isBox, centre: pointWithin(centre, world), half };
}

/** Whether a drawn point is inside a drawn crop, as its Gaussian is then drawn and exported. */
export function contains({ isBox, centre, half }, x, y, z) {
  const a = (x - centre[0]) / half[0];
  const b = (y - centre[1]) / half[1];
  const c = (z - centre[2]) / half[2];
  return isBox ? Math.abs(a) <= 1 && Math.abs(b) <= 1 && Math.abs(c) <= 1
    : a * a + b * b + c * c <= 1;
}

/** The edges of a drawn crop as pairs of points: those of a box, or three circles. */
export function outline({ isBox, centre, half }) {
  const at = (signs) => signs.map((sign, k) => centre[k] + sign * half[k]);
  if (isBox) {
    return [0, 1, 2].flatMap((axis) => [[-1, -1], [-1, 1], [1, -1], [1, 1]].map(([b, c]) =>
      [-1, 1].map((a) => {
        const signs = [0, 0, 0];
        [signs[axis], signs[(axis + 1) % 3], signs[(axis + 2) % 3]] = [a, b, c];
        return at(signs);
      })));
  }
  return [0, 1, 2].flatMap((axis) => Array.from({ length: SIDES }, (_, i) =>
    [i, i + 1].map((step) => {
      const angle = (2 * Math.PI * step) / SIDES;
      const signs = [0, 0, 0];
      [signs[axis], signs[(axis + 1) % 3]] = [Math.cos(angle), Math.sin(angle)];
      return at(signs);
    })));
}
