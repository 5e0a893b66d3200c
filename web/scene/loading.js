// A scene in its worker, which fetches and reads it, sorts it for each view, and finds surfaces.

import { NEAR } from "./gl.js";
import { SceneError } from "./ply.js";

/**
 * Fetches the scene at `url`, or with `isPoints` the sparse points of poses, to be drawn in
 * `world`. `progress(received, total)` is in bytes; `total` may be `null`. Returns
 * `{ whole, sort, meet, end }`: `whole` is a promise of the scene, `sort(row)` one of the order for
 * a third row of world to camera, `meet(ray)` one of the surface that a ray meets (`surfaceAt`).
 */
export function loading({ url, isPoints, headers }, world, progress) {
  const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  let ordered = null;
  // The worker answers in order.
  const waiting = [];
  const whole = new Promise((resolve, reject) => {
    worker.onmessage = ({ data }) => {
      if (data.scene) resolve(data.scene);
      else if (data.order) ordered(data.order);
      else if ("met" in data) waiting.shift()(data.met);
      else if (data.problem) reject(new SceneError(data.problem));
      else progress(data.received, data.total);
    };
    worker.onerror = (event) => {
      event.preventDefault();
      reject(new SceneError(`The scene could not be read: ${event.message ?? "no worker"}.`));
    };
  });
  worker.postMessage({ url: new URL(url, location.href).href, isPoints, headers, world });
  return {
    whole,
    sort: (row) => new Promise((resolve) => {
      ordered = resolve;
      worker.postMessage({ view: row, near: NEAR });
    }),
    meet: (ray) => new Promise((resolve) => {
      waiting.push(resolve);
      worker.postMessage({ ray: { ...ray, near: NEAR } });
    }),
    end: () => worker.terminate(),
  };
}
