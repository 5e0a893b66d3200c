// Lines over the scene, as the camera of the picture sees them.

import { along, dot } from "./camera.js";

/**
 * Dark lines below light ones, visible on any background. Colour and width, px.
 * @type {[string, number]}
 */
const BELOW = ["#000a", 3];

/** Lines are clipped nearer than this to the eye, in radii of the photographers' ring. */
export const NEAR = 0.002;

const seen = ({ axes, eye }, point) => axes.map((axis) => dot(axis, along(point, eye, -1)));

const onPicture = (k, [x, y, z]) => [(k.fx * x) / z + k.cx, (k.fy * y) / z + k.cy];

/** The pixel of a point; `null` if it is not farther than `near`. */
export function projected(pose, k, point, near) {
  const place = seen(pose, point);
  return place[2] > near ? onPicture(k, place) : null;
}

/**
 * Draws pairs of points on a 2-D context as seen from `pose` with the canvas's `k`.
 * @param {CanvasRenderingContext2D} context
 * @param {any} pose
 * @param {any} k
 * @param {number[][][]} pairs
 * @param {number} near
 * @param {[string, number]} style
 */
export function drawLines(context, pose, k, pairs, near, style) {
  const scale = k.width / context.canvas.clientWidth;
  context.beginPath();
  for (const [from, to] of pairs) line(context, pose, k, from, to, near);
  for (const [colour, wide] of [BELOW, style]) {
    context.strokeStyle = colour;
    context.lineWidth = wide * scale;
    context.stroke();
  }
}

/** Adds the part of a line in front of the eye to the path. */
function line(context, pose, k, from, to, near) {
  let [a, b] = [seen(pose, from), seen(pose, to)];
  if (a[2] > b[2]) [a, b] = [b, a];
  if (b[2] <= near) return;
  if (a[2] < near) a = along(a, along(b, a, -1), (near - a[2]) / (b[2] - a[2]));
  context.moveTo(...onPicture(k, a));
  context.lineTo(...onPicture(k, b));
}
