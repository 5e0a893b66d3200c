// The scene of one job for a frame in another page: `/embed#JOB/SECRET`, without the secret if
// the server needs no tokens. Browsers withhold cookies from such a frame.

import { api, h } from "./lib/dom.js";
import { scenePanel } from "./scene/panel.js";

const main = document.getElementById("main");

function say(words) {
  main.replaceChildren(h("p", { class: "problem", role: "alert" }, words));
}

async function open() {
  const [id, secret] = location.hash.slice(1).split("/");
  const base = `v1/jobs/${encodeURIComponent(id)}`;
  const headers = secret ? { Authorization: `Bearer ${secret}` } : {};
  /** @type {[import("fled-api").Job, any]} */
  const [job, { artifacts }] = await Promise.all([api(base, { headers }), api(`${base}/artifacts`, { headers })]);
  document.title = `${job.name || "Scene"} · fled`;
  const isThere = artifacts.some(({ name }) => name.endsWith("scene.ply"));
  if (!isThere) { say("This job has no scene yet."); return; }
  const cameras = await api(`${base}/artifacts/cameras.json`, { headers });
  const panel = scenePanel(id, headers);
  panel.update(job.name, cameras, artifacts, job.best_round);
  main.replaceChildren(panel.root);
}

open().catch((error) => {
  const isRefused = [401, 403, 404].includes(error.status);
  say(isRefused ? "This link does not work. It may be incomplete, expired or revoked." : error.message);
});
