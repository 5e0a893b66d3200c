// The world of a scene, drawn as one of ordinary size about the origin: WebGL has 32 bits a number.

import { poseOf, surroundingsOf } from "./camera.js";

/** As in normalisation.rs: scales are powers of this one, so that ordinary worlds stay. */
const SCALE_STEP = 16;
const LEAST_SIZE = 2;
const OFFSET_STEP = 4;

/** A world that is drawn as it is. */
export const AS_IT_IS = { offset: [0, 0, 0], scale: 1 };

/** `{ offset, scale }` of the world of these cameras: drawn = (world - offset) * scale. */
export function worldOf(cameras) {
  const { centre, radius } = surroundingsOf(cameras);
  if (!centre.every(Number.isFinite) || !(radius > 0)) return AS_IT_IS;
  const step = OFFSET_STEP * 2 ** Math.floor(Math.log2(radius));
  const steps = Math.floor(Math.log(radius / LEAST_SIZE) / Math.log(SCALE_STEP));
  return {
    // Without the sum a zero may be negative.
    offset: centre.map((value) => Math.round(value / step) * step + 0),
    scale: SCALE_STEP ** -steps,
  };
}

/** A point of the world as it is drawn. */
export const pointWithin = (point, { offset, scale }) =>
  point.map((value, k) => (value - offset[k]) * scale);

/** A camera of cameras.json as it is drawn. */
export function cameraWithin(camera, world) {
  const { axes, eye } = poseOf(camera);
  return { ...camera, world_to_camera: rigid(axes, pointWithin(eye, world)) };
}

/** World to camera, four rows, of a pose that is drawn. */
export const matrixInWorld = ({ axes, eye }, { offset, scale }) =>
  rigid(axes, eye.map((value, k) => value / scale + offset[k]));

const rigid = (axes, eye) => [
  ...axes.map((axis) => [...axis, -(axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2])]),
  [0, 0, 0, 1],
];
