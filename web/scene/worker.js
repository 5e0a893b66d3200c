// A worker, to keep the page responsive: fetches and reads a scene, and sorts it for each view.

import { SceneError, readScene } from "./ply.js";
import { pointsOf } from "./points.js";
import { sorter } from "./sort.js";

let sort = null;

async function load({ url, isPoints, headers, world }) {
  const response = await fetch(url, { headers });
  if (!response.ok) {
    const problem = await response.json().catch(() => null);
    throw new SceneError(problem?.detail ?? `The server responded with status ${response.status}.`);
  }
  const total = Number(response.headers.get("content-length")) || null;
  const scene = isPoints ? pointsOf(await response.json(), world)
    : await readScene(response.body, (received) => postMessage({ received, total }), world);
  // The arrays are transferred to the page, so sorting needs a copy.
  sort = sorter(scene.geometry.slice());
  postMessage({ scene }, { transfer: [scene.geometry.buffer, scene.harmonics.buffer] });
}

onmessage = ({ data }) => {
  if (data.view) {
    const order = sort(data.view, data.near);
    postMessage({ order }, { transfer: [order.buffer] });
    return;
  }
  load(data).catch((error) => {
    const words = error instanceof SceneError ? error.message
      : `The scene could not be loaded completely: ${error.message}.`;
    postMessage({ problem: words });
  });
};
