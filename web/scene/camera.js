// Camera mathematics, with OpenCV's axes: x right, y down, z forward.
//
// A pose is `{ axes, eye, distance }`: the camera's axes in the world (the rows of world to
// camera), its position, and the distance ahead to the point that it orbits.

/** Steepest view up or down, radians, as left and right are undefined at the pole. */
const STEEPEST = (85 * Math.PI) / 180;
/** Limits of the distance to the orbited point, in radii of the photographers' ring. */
const NEAREST = 0.15;
const FARTHEST = 12;
/** Weight of a guess against the crossing of the lines of sight, as in orbit.rs. */
const GUESS_WEIGHT = 1e-3;
/** How level people hold a camera and how far all look up or down, degrees, as in upright.rs. */
const ROLL = 2.5;
const PITCH = 15;
/** When cameras look straight down, as in upright.rs. */
const LEAST_SHARE = 0.1;
const IN_COMMON = 0.9;
const LEVEL = 0.17;
const LESS_ROLL = 0.09;
const MORE = 0.3;
const APART = 0.7;

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0]];
/** a + s b. */
export const along = (a, b, s) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
export const unit = (a) => {
  const length = Math.hypot(...a);
  return length > 0 ? a.map((value) => value / length) : a;
};
const mean = (vectors) => vectors
  .reduce((sum, one) => along(sum, one, 1), [0, 0, 0])
  .map((value) => value / vectors.length);
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** The pose of a camera of cameras.json. */
export function poseOf({ world_to_camera: rows }, surroundings) {
  const axes = rows.slice(0, 3).map((row) => row.slice(0, 3));
  const shift = rows.slice(0, 3).map((row) => row[3]);
  const eye = [0, 1, 2].map((k) => -(axes[0][k] * shift[0] + axes[1][k] * shift[1]
    + axes[2][k] * shift[2]));
  if (!surroundings) return { axes, eye, distance: 1 };
  const ahead = dot(along(surroundings.centre, eye, -1), axes[2]);
  const { radius } = surroundings;
  return { axes, eye, distance: clamp(ahead, 0.3 * radius, 2 * radius) };
}

/** World to camera of a pose, four rows. */
export const matrixOf = ({ axes, eye }) =>
  [...axes.map((axis) => [...axis, -dot(axis, eye)]), [0, 0, 0, 1]];

/** The field of view of `k`, all of it visible, on a picture of another shape. */
export function fitted(k, width, height) {
  const scale = Math.min(width / k.width, height / k.height);
  return {
    width, height, fx: k.fx * scale, fy: k.fy * scale,
    cx: width / 2 + (k.cx - k.width / 2) * scale, cy: height / 2 + (k.cy - k.height / 2) * scale,
  };
}

/** The ray through a pixel of `k`: `{ eye, direction, pixel }`, the angle of a pixel in radians. */
export function rayOf({ axes, eye }, { fx, fy, cx, cy }, [x, y]) {
  const slopes = [(x - cx) / fx, (y - cy) / fy, 1];
  const direction = slopes.reduce((sum, slope, k) => along(sum, axes[k], slope), [0, 0, 0]);
  return { eye, direction: unit(direction), pixel: 1 / fx };
}

/** The vertical field of view of `k`, radians. */
export const angleOf = (k) => 2 * Math.atan(k.height / (2 * k.fy));

/** `k` with `angle` as vertical field of view. */
export function seenAt(k, angle) {
  const nearer = Math.tan(angleOf(k) / 2) / Math.tan(angle / 2);
  return { ...k, fx: k.fx * nearer, fy: k.fy * nearer };
}

/** The ring of the photographers: `{ centre, radius, up }`, as orbit.rs finds it. */
export function surroundingsOf(cameras) {
  const poses = cameras.map((camera) => poseOf(camera));
  const middle = mean(poses.map(({ eye }) => eye));
  const forward = unit(mean(poses.map(({ axes }) => axes[2])));
  const spread = Math.max(...poses.map(({ eye }) => Math.hypot(...along(eye, middle, -1))));
  const guess = along(middle, forward, spread > 0 ? 2 * spread : 1);
  const found = crossing(poses, guess);
  const isAhead = found.every(Number.isFinite) && dot(along(found, middle, -1), forward) > 0;
  const centre = isAhead ? found : guess;
  const distances = poses.map(({ eye }) => Math.hypot(...along(eye, centre, -1)));
  const radius = distances.sort((a, b) => a - b)[Math.floor(distances.length / 2)];
  return { centre, radius: radius || 1, up: upOf(poses) };
}

/** The direction that is up in the world of these poses, as upright.rs finds it. */
function upOf(poses) {
  const rows = diagonal((ROLL / PITCH) ** 2);
  for (const { axes: [x] } of poses) {
    for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++) rows[i][j] += x[i] * x[j];
  }
  const against = (k) => mean(poses.map(({ axes }) => axes[k])).map((value) => -value);
  const [upward, back] = [against(1), against(2)];
  const [up, above] = [upward, back].map((wanted) => unit(solved(rows, wanted)));
  const roll = (one) => Math.hypot(...poses.map(({ axes }) => dot(axes[0], one)))
    / Math.sqrt(poses.length);
  const rolls = [up, above].map(roll);
  const shares = [dot(up, upward), dot(above, back)];
  const isLevel = rolls[0] < rolls[1] + LESS_ROLL;
  const isSimilar = Math.abs(dot(up, above)) > APART || shares[1] < shares[0] + MORE;
  const mayBeOverhead = Math.hypot(...upward) < IN_COMMON && rolls[1] < LEVEL && shares[1] > MORE;
  const isUnknown = shares[0] < LEAST_SHARE && shares[0] < shares[1];
  return (mayBeOverhead && !(isLevel && isSimilar)) || isUnknown ? above : up;
}

/** The point nearest to all lines of sight, pulled slightly towards the guess. */
function crossing(poses, guess) {
  const weight = GUESS_WEIGHT * poses.length;
  const rows = diagonal(weight);
  const sums = guess.map((value) => weight * value);
  for (const { axes: [, , f], eye } of poses) {
    for (let i = 0; i < 3; i++) {
      for (let j = 0; j < 3; j++) {
        const across = (i === j ? 1 : 0) - f[i] * f[j];
        rows[i][j] += across;
        sums[i] += across * eye[j];
      }
    }
  }
  return solved(rows, sums);
}

const diagonal = (value) => [[value, 0, 0], [0, value, 0], [0, 0, value]];

/** The solution of three equations by Cramer's rule. The matrix is symmetric: rows are columns. */
function solved(rows, sums) {
  const whole = dot(rows[0], cross(rows[1], rows[2]));
  return [0, 1, 2].map((k) => {
    const [a, b, c] = rows.map((row, i) => (i === k ? sums : row));
    return dot(a, cross(b, c)) / whole;
  });
}

/** A vector rotated about a unit axis, right-handed. */
function rotated(v, axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return along(along(v.map((value) => value * c), cross(axis, v), s), axis, dot(axis, v) * (1 - c));
}

/** Makes axes orthogonal again, after many turns. */
function squared([x, , z]) {
  const forward = unit(z);
  const right = unit(along(x, forward, -dot(x, forward)));
  return [right, cross(forward, right), forward];
}

/** The pose rotated about `point`: by `right` about `up`, then by `upward` in pitch. */
function turned(pose, up, point, right, upward) {
  const across = cross(pose.axes[2], up);
  // A camera that looks straight down, as from a drone, has no horizon.
  const level = Math.hypot(...across) > 1e-3 ? unit(across) : pose.axes[0];
  const pitch = Math.asin(clamp(dot(pose.axes[2], up), -1, 1));
  // A photograph may look steeper already; then it can only turn back.
  const most = Math.max(STEEPEST, Math.abs(pitch));
  const tilt = clamp(pitch + upward, -most, most) - pitch;
  const turn = (v) => rotated(rotated(v, level, tilt), up, right);
  return {
    ...pose,
    axes: squared(pose.axes.map(turn)),
    eye: along(point, turn(along(pose.eye, point, -1)), 1),
  };
}

/** Orbits the point ahead: to the right and up, radians. */
export const orbited = (pose, { up }, right, upward) =>
  turned(pose, up, along(pose.eye, pose.axes[2], pose.distance), right, -upward);

/** Turns in place: to the right and up, radians. */
export const looked = (pose, { up }, right, upward) => turned(pose, up, pose.eye, -right, upward);

/** Walks: right, down and forward, world units. */
export const walked = (pose, steps) => ({
  ...pose,
  eye: steps.reduce((eye, step, k) => along(eye, pose.axes[k], step), pose.eye),
});

/** Rises along the world's up axis, world units. */
export const risen = (pose, { up }, step) => ({ ...pose, eye: along(pose.eye, up, step) });

/** Scales the distance to the point ahead; below the least distance it walks on. */
export function neared(pose, { radius }, factor) {
  const step = pose.distance * (1 - factor);
  const distance = clamp(pose.distance - step, NEAREST * radius, FARTHEST * radius);
  if (factor > 1 && distance === pose.distance) return pose;
  return { ...walked(pose, [0, 0, step]), distance };
}

/** Interpolates two poses: `part` 0 is the first, 1 the second. */
export function between(a, b, part) {
  if (part >= 1) return b;
  const mix = (u, v) => along(u, along(v, u, -1), part);
  return {
    axes: squared(a.axes.map((axis, k) => mix(axis, b.axes[k]))),
    eye: mix(a.eye, b.eye),
    distance: a.distance + (b.distance - a.distance) * part,
  };
}
