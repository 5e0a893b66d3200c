// Moves and scales a scene's world to ordinary size about the origin, as WebGL has 32-bit numbers.

import { poseOf, surroundingsOf } from "./camera.js";

/** Scales are powers of this, as in normalisation.rs, so that ordinary worlds stay. */
const SCALE_STEP = 16;
const LEAST_SIZE = 2;
const OFFSET_STEP = 4;

/** A world drawn unchanged. */
export const AS_IT_IS = { offset: [0, 0, 0], scale: 1 };

/** `{ offset, scale }` for the world of these cameras: drawn = (world - offset) * scale. */
export function worldOf(cameras) {
  const { centre, radius } = surroundingsOf(cameras);
  if (!centre.every(Number.isFinite) || !(radius > 0)) return AS_IT_IS;
  const step = OFFSET_STEP * 2 ** Math.floor(Math.log2(radius));
  const steps = Math.floor(Math.log(radius / LEAST_SIZE) / Math.log(SCALE_STEP));
  return {
    // Adding 0 avoids a negative zero.
    offset: centre.map((value) => Math.round(value / step) * step + 0),
    scale: SCALE_STEP ** -steps,
  };
}

/** A world point as drawn. */
export const pointWithin = (point, { offset, scale }) =>
  point.map((value, k) => (value - offset[k]) * scale);

/** A camera of cameras.json as drawn. */
export function cameraWithin(camera, world) {
  const { axes, eye } = poseOf(camera);
  return { ...camera, world_to_camera: rigid(axes, pointWithin(eye, world)) };
}

/** World to camera, four rows, of a drawn pose. */
export const matrixInWorld = ({ axes, eye }, { offset, scale }) =>
  rigid(axes, eye.map((value, k) => value / scale + offset[k]));

const rigid = (axes, eye) => [
  ...axes.map((axis) => [...axis, -(axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2])]),
  [0, 0, 0, 1],
];
