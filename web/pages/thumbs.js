// A pair of thumbnails per job: one of its dark photographs, and the same view restored.

import { address, api, h } from "../lib/dom.js";
import { thumbnail } from "../lib/photographs.js";

/** Parallel requests; a list must not use up the client's rate limit. */
const AT_ONCE = 3;

/**
 * Makes the pair of a job, loads it when it comes near, and reuses it when redrawn. A job without a
 * render has a photograph of its capture. `also(job)` loads what else is shown with it.
 * @param {(job: import("fled-api").Job) => unknown} also
 */
export function thumbs(also = () => null) {
  const made = new Map();
  const waiting = [];
  let busy = 0;
  const near = new IntersectionObserver(
    (seen) => {
      for (const { isIntersecting, target } of seen) {
        if (!isIntersecting) continue;
        near.unobserve(target);
        waiting.push(target);
        work();
      }
    },
    { rootMargin: "200px" },
  );

  async function work() {
    if (busy >= AT_ONCE || waiting.length === 0) return;
    busy += 1;
    try {
      await waiting.shift().load();
    } finally {
      busy -= 1;
      work();
    }
  }

  function pairOf(job) {
    const round = restored(job);
    // A job that ends has a verdict, too, even if its last round is shown already.
    const key = `${round} ${job.state === "succeeded"} ${job.finished_at}`;
    const known = made.get(job.id);
    if (known?.key === key) return known;
    if (known) near.unobserve(known);
    const pair = Object.assign(h("span", { class: "pair" }), {
      key,
      load: () => Promise.all([round ? fill(pair, job.id, round) : photograph(pair, job), also(job)]),
    });
    made.set(job.id, pair);
    near.observe(pair);
    return pair;
  }
  return { pairOf, leave: () => near.disconnect() };
}

/**
 * The round to show: the delivered one, or the last finished; 0 before the first.
 * @param {import("fled-api").Job} job
 */
function restored(job) {
  if (job.state === "succeeded" && job.best_round) return job.best_round;
  return Math.max(
    0,
    ...job.stages.filter((stage) => stage.stage === "evaluate").map((stage) => stage.round),
  );
}

/** Prefers a held-out view, whose render shows how the scene generalises. */
async function fill(pair, id, round) {
  const base = `v1/jobs/${id}/artifacts`;
  const cameras = await api(`${base}/cameras.json`).catch(() => []);
  const view = cameras.find((one) => one.split === "held_out") ?? cameras[0];
  if (!view) return;
  const picture = (path, alt) => {
    const image = h("img", {
      src: `${base}/${address(`${path}/${view.name}.jpg`)}`,
      alt,
      loading: "lazy",
    });
    image.addEventListener("error", () => image.remove());
    return image;
  };
  pair.append(
    picture("inputs", `Photograph ${view.name}`),
    picture(`rounds/${round}/renders`, "Restored view"),
  );
}

/** The first photograph of a job's capture. */
async function photograph(pair, job) {
  const capture = await api(`v1/captures/${job.capture_id}`).catch(() => null);
  const image = capture?.images.find(({ accepted }) => accepted);
  const small = image && thumbnail(capture, image);
  if (small) pair.append(small);
}
