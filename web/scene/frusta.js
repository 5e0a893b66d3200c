// The photographs' cameras, drawn as lines over the scene.

import { along, poseOf } from "./camera.js";
import { NEAR, drawLines, projected } from "./lines.js";

/** Length of a frustum, in radii of the photographers' ring. */
const DEPTH = 0.055;
/** Largest distance of a click from a camera that it selects, px. */
const REACH = 14;
/**
 * Colour and width, px.
 * @type {[string, number][]}
 */
const [LINE, CHOSEN] = [["#f2b84b", 1.3], ["#6cb6ff", 1.8]];

/** The frusta of `cameras`: `draw` paints them, `at` finds the clicked one. */
export function frusta(cameras, { radius }) {
  const shapes = cameras.map((camera) => shape(camera, DEPTH * radius));

  return {
    /** Draws on a 2-D context as seen from `pose` with the canvas's `k`; `chosen` is an index. */
    draw(context, pose, k, chosen) {
      const order = shapes.map((_, i) => i).filter((i) => i !== chosen);
      if (chosen >= 0) order.push(chosen);
      for (const i of order) {
        if (isInside(pose, shapes[i], radius)) continue;
        const style = i === chosen ? CHOSEN : LINE;
        drawLines(context, pose, k, edges(shapes[i]), NEAR * radius, style);
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
