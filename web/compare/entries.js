// The jobs of a comparison: what there is of each, and a sentence where that is not all.

import { mark } from "../lib/chart.js";
import { api, count, h } from "../lib/dom.js";
import { MOST_COMPARED } from "../lib/place.js";
import { doing, isOver } from "../lib/state.js";
import { failed } from "../lib/words.js";

/** The jobs that an address names, each once: `{ ids, left }`, `left` being those too many. */
export function named(list) {
  const parts = list.split(",").map((part) => decoded(part).trim());
  const ids = [...new Set(parts.filter(Boolean))];
  return { ids: ids.slice(0, MOST_COMPARED), left: Math.max(0, ids.length - MOST_COMPARED) };
}

/** Not every address that somebody types can be decoded. */
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/** A job of a comparison: a letter and a style of its own from the first to the last look. */
export const entry = (id, number) => ({
  id,
  number,
  letter: "ABCDEF"[number],
  style: `k${number}`,
  job: /** @type {import("fled-api").Job | null} */ (null),
  rounds: [],
  report: null,
  cameras: [],
  problem: "",
  seen: "",
  isGone: false,
});

/** Asks the server again for what may have changed; whether anything has. */
export async function look(one) {
  const base = `/v1/jobs/${encodeURIComponent(one.id)}`;
  const before = JSON.stringify([one.job, one.problem]);
  try {
    one.job = await api(base);
    one.problem = "";
    const seen = `${one.job.state} ${one.job.attempts} ${one.job.stages.length}`;
    if (seen !== one.seen) {
      await lookInside(one, base);
      one.seen = seen;
    }
  } catch (error) {
    // One that is gone stays gone; any other problem may pass, and what was there is kept.
    one.problem = error.message;
    if (error.status === 404) {
      one.problem = "Job not found. It was deleted, or the link is incomplete.";
      Object.assign(one, { job: null, rounds: [], report: null, cameras: [], isGone: true });
    }
  }
  return before !== JSON.stringify([one.job, one.problem]);
}

async function lookInside(one, base) {
  one.report = await api(`${base}/rounds`);
  one.rounds = one.report.rounds;
  if (one.rounds.length === 0) one.cameras = [];
  else one.cameras = await api(`${base}/artifacts/cameras.json`).catch(() => []);
}

/** Whether there is nothing more to come of it. */
export const isDone = (one) =>
  one.isGone || (one.job !== null && isOver(one.job) && one.problem === "");

export const nameOf = (one) => one.job?.name || (one.job ? "unnamed" : "missing job");

/** Mark and letter, and the name for whoever needs it said. */
export const tag = (one) =>
  h("span", { class: `tag ${one.style}` }, mark(one.number, one.style), h("b", {}, one.letter));

/** As words alone. */
export const called = (one) => `${one.letter}, ${nameOf(one)}`;

/** A sentence about a job that lacks something; nothing where all is there. */
export function note({ job, problem, rounds }) {
  if (!job || problem) return problem;
  const had =
    rounds.length > 0
      ? `Results are from ${count(rounds.length, "finished round")}.`
      : "No round has finished.";
  switch (job.state) {
    case "queued":
      return `Waiting (${doing(job) || "for its turn"}). There is nothing to compare yet.`;
    case "running":
      return rounds.length > 0
        ? `Still running (${doing(job)}). ${had}`
        : `Still running (${doing(job)}). No round has finished yet.`;
    case "failed":
      return `Failed: ${failed(job.error)}. ${had}`;
    case "cancelled":
      return `Cancelled. ${had}`;
    default:
      return "";
  }
}
