// The scene in 3D on a job's page: a poster until it is opened. Only then the scene and the code
// of the view are loaded.

import { address, h, size } from "../lib/dom.js";

/**
 * The section of a page for the scene of `job`: `{ root, update, leave }`. `headers` go with each
 * request if there is no cookie. `shaping` is what the user draws there, if it may be drawn.
 */
export function scenePanel(job, headers = {}, shaping = null) {
  const image = h("img", { alt: "", draggable: false });
  const bytes = h("span", { class: "soft" });
  const words = h("span", { class: "words" });
  const poster = h("button", { type: "button", class: "poster", onclick: open },
    h("span", { class: "frame" }, image, h("span", { class: "invitation" }, words, bytes)));
  const place = h("div", {}, poster);
  const problem = h("p", { class: "problem", role: "alert" });
  const root = h("section", { class: "scene", hidden: true }, h("h2", {}, "Scene"), place, problem);
  let [facts, view, isGone, isOpening] = [null, null, false, false];
  const invite = () => {
    words.textContent = facts?.first.isPoints ? "View cameras and points" : "Walk through the scene";
  };

  async function open() {
    if (isOpening) return;
    isOpening = true;
    problem.textContent = "";
    words.textContent = "Opening…";
    try {
      const { openScene } = await import("./view.js");
      if (isGone) return;
      view = await openScene(place, { job, headers, ...facts, shaping, ended: close });
      if (isGone) leave();
    } catch (error) {
      close(error.message);
    }
    isOpening = false;
  }

  function close(why) {
    view?.leave();
    view = null;
    invite();
    problem.textContent = why;
    place.replaceChildren(poster);
    if (!why) poster.focus();
  }

  function leave() {
    isGone = true;
    view?.leave();
  }

  async function paint(url) {
    image.dataset.of = url;
    if (!headers.Authorization) { image.src = url; return; }
    const answer = await fetch(url, { headers });
    if (!answer.ok) return;
    const own = URL.createObjectURL(await answer.blob());
    image.addEventListener("load", () => URL.revokeObjectURL(own), { once: true });
    image.src = own;
  }

  image.addEventListener("error", () => { image.hidden = true; });
  return {
    root,
    leave,
    /**
     * Takes the name, cameras and files of the job; `best` is the delivered round. `place` names the
     * view to start from, if known: that which the scene shows best.
     */
    update(name, cameras, artifacts, best, place = "") {
      const scenes = scenesOf(job, artifacts, best);
      root.hidden = scenes.length === 0 || cameras.length === 0;
      if (root.hidden) return;
      const first = scenes.find((scene) => scene.isDelivered) ?? scenes.at(-1);
      const middle = cameras[Math.floor(cameras.length / 2)];
      const known = cameras.find((camera) => camera.name === place);
      const start = (known ?? middle).name;
      facts = { name, scenes, first, start, isBest: known !== undefined };
      if (!isOpening) invite();
      bytes.textContent = size(first.bytes);
      const path = first.isPoints ? "poses.svg" : `rounds/${first.round}/renders/${start}.jpg`;
      const url = `v1/jobs/${job}/artifacts/${address(path)}`;
      const isThere = artifacts.some((file) => file.name === path);
      if (isThere && image.dataset.of !== url) paint(url);
      image.hidden = !isThere;
      const { width, height } = cameras.find(({ name }) => name === start);
      root.style.setProperty("--shape", width / height);
      view?.update(scenes);
    },
  };
}

/**
 * `{ round, url, bytes, isDelivered, isPoints }` of the sparse points of the poses, as round 0, and
 * of every round whose scene is served.
 */
function scenesOf(job, artifacts, best) {
  const scenes = new Map();
  for (const { name, bytes } of artifacts) {
    if (name === "poses.json") {
      scenes.set(0, { round: 0, bytes, isPoints: true, url: `v1/jobs/${job}/artifacts/${name}` });
      continue;
    }
    const isDelivered = name === "scene.ply";
    const found = name.match(/^rounds\/(\d+)\/scene\.ply$/);
    const round = isDelivered ? best : found && Number(found[1]);
    // The delivered scene is a copy of one round's.
    if (!round || scenes.get(round)?.isDelivered) continue;
    scenes.set(round, { round, bytes, isDelivered, url: `v1/jobs/${job}/artifacts/${name}` });
  }
  return [...scenes.values()].sort((a, b) => a.round - b.round);
}
