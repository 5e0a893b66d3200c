// The photographs' cameras, drawn as lines over the scene.

import { along, dot, poseOf } from "./camera.js";

/** Length of a frustum, in radii of the photographers' ring. */
const DEPTH = 0.055;
/** Lines are clipped nearer than this to the eye, in the same unit. */
const NEAR = 0.002;
/** Largest distance of a click from a camera that it selects, px. */
const REACH = 14;
/**
 * Dark lines below light ones, visible on any background. Colour and width, px.
 * @type {[string, number][]}
 */
const [BELOW, LINE, CHOSEN] = [["#000a", 3], ["#f2b84b", 1.3], ["#6cb6ff", 1.8]];

/** The frusta of `cameras`: `draw` paints them, `at` finds the clicked one. */
export function frusta(cameras, { radius }) {
  const shapes = cameras.map((camera) => shape(camera, DEPTH * radius));

  return {
    /** Draws on a 2-D context as seen from `pose` with the canvas's `k`; `chosen` is an index. */
    draw(context, pose, k, chosen) {
      const scale = k.width / context.canvas.clientWidth;
      context.clearRect(0, 0, k.width, k.height);
      const order = shapes.map((_, i) => i).filter((i) => i !== chosen);
      if (chosen >= 0) order.push(chosen);
      for (const i of order) {
        if (isInside(pose, shapes[i], radius)) continue;
        context.beginPath();
        for (const [a, b] of edges(shapes[i])) line(context, pose, k, a, b, NEAR * radius);
        for (const [colour, wide] of [BELOW, i === chosen ? CHOSEN : LINE]) {
          context.strokeStyle = colour;
          context.lineWidth = wide * scale;
          context.stroke();
        }
      }
    },
    /** The camera nearest to a point of the canvas, px; -1 for none. */
    at(pose, k, [x, y], scale) {
      let [best, nearest] = [-1, REACH * scale];
      shapes.forEach((one, i) => {
        if (isInside(pose, one, radius)) return;
        const point = projected(pose, k, one.eye, NEAR * radius);
        const away = point ? Math.hypot(point[0] - x, point[1] - y) : Infinity;
        if (away < nearest) [best, nearest] = [i, away];
      });
      return best;
    },
  };
}

function shape(camera, depth) {
  const { axes, eye } = poseOf(camera);
  const { width, height, fx, fy, cx, cy } = camera;
  const corner = ([x, y]) => [(x - cx) / fx, (y - cy) / fy, 1]
    .reduce((point, slope, k) => along(point, axes[k], depth * slope), eye);
  const ends = [[0, 0], [width, 0], [width, height], [0, height]];
  return { eye, corners: ends.map(corner) };
}

const edges = ({ eye, corners }) => corners.flatMap((corner, i) =>
  [[eye, corner], [corner, corners[(i + 1) % 4]]]);

/** Whether the view is at a camera, whose lines would cross the whole picture. */
const isInside = (pose, { eye }, radius) =>
  Math.hypot(...along(eye, pose.eye, -1)) < 0.5 * DEPTH * radius;

const seen = ({ axes, eye }, point) => axes.map((axis) => dot(axis, along(point, eye, -1)));

const onPicture = (k, [x, y, z]) => [(k.fx * x) / z + k.cx, (k.fy * y) / z + k.cy];

function projected(pose, k, point, near) {
  const place = seen(pose, point);
  return place[2] > near ? onPicture(k, place) : null;
}

/** Draws the part of a line in front of the eye. */
function line(context, pose, k, from, to, near) {
  let [a, b] = [seen(pose, from), seen(pose, to)];
  if (a[2] > b[2]) [a, b] = [b, a];
  if (b[2] <= near) return;
  if (a[2] < near) a = along(a, along(b, a, -1), (near - a[2]) / (b[2] - a[2]));
  context.moveTo(...onPicture(k, a));
  context.lineTo(...onPicture(k, b));
}
