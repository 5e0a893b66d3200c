// The view that is shown, as the server renders it.

import { Refusal, h } from "../lib/dom.js";

/** The server renders no larger pictures, px. */
const LONGEST = 2048;

/** The body of `POST /v1/jobs/{id}/render` for world to camera with intrinsics `k`, `ev` stops brighter. */
export function request(scene, matrix, k, ev = 0) {
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
  };
}

/** Fetches the picture, a file `name`, and has the browser save it. */
export async function savedPicture(job, name, scene, matrix, k, ev) {
  const response = await fetch(`/v1/jobs/${job}/render`, {
    method: "POST", headers: { "Content-Type": "application/json" },
    body: JSON.stringify(request(scene, matrix, k, ev)),
  });
  if (!response.ok) throw new Refusal(response.status, await response.json().catch(() => null));
  const href = URL.createObjectURL(await response.blob());
  h("a", { href, download: name }).click();
  // The browser has taken it by then.
  setTimeout(() => URL.revokeObjectURL(href), 10_000);
}
