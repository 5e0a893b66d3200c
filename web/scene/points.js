// The sparse points of poses as a scene of small round Gaussians.

import { GEOMETRY, SceneError, harmonicsRow } from "./ply.js";
import { AS_IT_IS, pointWithin } from "./world.js";

/** Standard deviation of a point, as a share of the points' spread. */
const SIZE = 0.008;
const OPACITY = 0.95;
/** Y_0^0, the constant harmonic. */
const Y00 = 0.2820948;

/**
 * `{ count, degree, geometry, harmonics, isGuessed }` of the points of poses.json, drawn in
 * `world`. For poses without points, these are the guessed points that start a scene.
 */
export function pointsOf({ points }, world = AS_IT_IS) {
  if (!Array.isArray(points) || points.length === 0) {
    throw new SceneError("The poses contain no points.");
  }
  const places = points.map(({ position }) => pointWithin(position, world));
  const variance = (SIZE * spread(places)) ** 2;
  const geometry = new Float32Array(GEOMETRY * points.length);
  const harmonics = new Float32Array(harmonicsRow(0) * points.length);
  points.forEach(({ colour }, i) => {
    geometry.set([...places[i], OPACITY, variance, 0, 0, variance, 0, variance], GEOMETRY * i);
    harmonics.set(colour.map((value) => (value / 255 - 0.5) / Y00), harmonicsRow(0) * i);
  });
  const isGuessed = points.every(({ track }) => track === 0);
  return { count: points.length, degree: 0, geometry, harmonics, isGuessed };
}

/** Median distance from the median point, which ignores a few outliers. */
function spread(positions) {
  const middle = [0, 1, 2].map((k) => median(positions.map((one) => one[k])));
  const away = positions.map((one) => Math.hypot(...one.map((value, k) => value - middle[k])));
  return median(away) || 1;
}

const median = (values) => values.sort((a, b) => a - b)[Math.floor(values.length / 2)];
