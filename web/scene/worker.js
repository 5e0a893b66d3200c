// A worker, to keep the page responsive: fetches and reads a scene, sorts it for each view, and
// finds surfaces in it.

import { SceneError, readScene } from "./ply.js";
import { pointsOf } from "./points.js";
import { sorter } from "./sort.js";
import { surfaceAt } from "./surface.js";

let [sort, geometry] = [null, null];

async function load({ url, isPoints, headers, world }) {
  const response = await fetch(url, { headers });
  if (!response.ok) {
    const problem = await response.json().catch(() => null);
    throw new SceneError(problem?.detail ?? `The server responded with status ${response.status}.`);
  }
  const total = Number(response.headers.get("content-length")) || null;
  const scene = isPoints ? pointsOf(await response.json(), world)
    : await readScene(response.body, (received) => postMessage({ received, total }), world);
  // The arrays are transferred to the page, so a copy stays here.
  geometry = scene.geometry.slice();
  sort = sorter(geometry);
  postMessage({ scene }, { transfer: [scene.geometry.buffer, scene.harmonics.buffer] });
}

onmessage = ({ data }) => {
  if (data.view) {
    const order = sort(data.view, data.near);
    postMessage({ order }, { transfer: [order.buffer] });
    return;
  }
  if (data.ray) {
    postMessage({ met: surfaceAt(geometry, data.ray) });
    return;
  }
  load(data).catch((error) => {
    const words = error instanceof SceneError ? error.message
      : `The scene could not be loaded completely: ${error.message}.`;
    postMessage({ problem: words });
  });
};
