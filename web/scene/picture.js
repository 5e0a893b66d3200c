// The current view, rendered by the server.

import { answer } from "../lib/dom.js";
import { saved } from "../lib/download.js";
import { cropText } from "../lib/shaping.js";

/** Longest side that the server renders, px. */
const LONGEST = 2048;

/**
 * The body of `POST /v1/jobs/{id}/render`: world to camera, intrinsics `k`, stops brighter, and the
 * crop as shaping has it, if there is one.
 */
export function request(scene, matrix, k, ev = 0, crop = null) {
  const scale = Math.min(1, LONGEST / Math.max(k.width, k.height));
  const side = (length) => Math.max(16, Math.round(length * scale));
  const [width, height] = [side(k.width), side(k.height)];
  const [x, y] = [width / k.width, height / k.height];
  return {
    world_to_camera: matrix,
    intrinsics: { width, height, fx: k.fx * x, fy: k.fy * y, cx: k.cx * x, cy: k.cy * y },
    // The delivered scene has no number.
    ...(scene.isDelivered ? {} : { round: scene.round }),
    format: "png",
    ev,
    ...(crop ? { crop: cropText(crop) } : {}),
  };
}

/** Fetches the picture and has the browser save it as `name`. */
export async function savedPicture(job, name, scene, matrix, k, ev, crop) {
  const response = await answer(`v1/jobs/${job}/render`, {
    method: "POST", headers: { "Content-Type": "application/json" },
    body: JSON.stringify(request(scene, matrix, k, ev, crop)),
  });
  saved(await response.blob(), name);
}
