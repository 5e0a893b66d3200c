// The jobs of a comparison: the data of each, and a sentence if some is missing.

import { mark } from "../lib/chart.js";
import { api, count, h } from "../lib/dom.js";
import { MOST_COMPARED } from "../lib/place.js";
import { doing, isOver } from "../lib/state.js";
import { failed } from "../lib/words.js";

/** The distinct jobs in an address: `{ ids, left }`; `left` are those beyond the limit. */
export function named(list) {
  const parts = list.split(",").map((part) => decoded(part).trim());
  const ids = [...new Set(parts.filter(Boolean))];
  return { ids: ids.slice(0, MOST_COMPARED), left: Math.max(0, ids.length - MOST_COMPARED) };
}

/** A typed address may be impossible to decode. */
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/** A job of a comparison, with a letter and a style that do not change. */
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

/** Asks the server for what may have changed; returns whether anything has. */
export async function look(one) {
  const base = `v1/jobs/${encodeURIComponent(one.id)}`;
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
    // A job that is gone stays gone; any other problem may pass, so the data is kept.
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

/** Whether no more data will come. */
export const isDone = (one) =>
  one.isGone || (one.job !== null && isOver(one.job) && one.problem === "");

export const nameOf = (one) => one.job?.name || (one.job ? "unnamed" : "missing job");

/** Mark and letter, with the name for screen readers. */
export const tag = (one) =>
  h("span", { class: `tag ${one.style}` }, mark(one.number, one.style), h("b", {}, one.letter));

/** The same as text. */
export const called = (one) => `${one.letter}, ${nameOf(one)}`;

/** A sentence about what a job lacks; nothing if it is complete. */
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
