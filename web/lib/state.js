// Text for a job's state.

import { count, duration, h, plain, serverNow, stopwatch } from "./dom.js";

/** @typedef {import("fled-api").Job} Job */

/** @param {Job} job */
export const isOver = (job) => ["succeeded", "failed", "cancelled"].includes(job.state);

/**
 * The word for its state.
 * @param {Job} job
 */
export const stateWord = (job) => (job.cancel_requested && job.state === "running" ? "cancelling" : job.state);

/**
 * The pill that shows a state.
 * @param {Job} job
 */
export const pill = (job) => h("span", { class: `state ${job.state}` }, stateWord(job));

/**
 * The current activity of a job, in a few words.
 * @param {Job} job
 */
export function doing(job) {
  if (job.state === "queued") return [place(job), urgency(job), job.error && "waiting to retry"].filter(Boolean).join(", ");
  if (job.state !== "running") return "";
  const round = job.round > 0 ? `round ${job.round} of ${job.rounds}` : "";
  return [round, job.stage].filter(Boolean).join(", ") || "starting";
}

/** @param {Job} job */
const urgency = ({ priority }) => (priority ? `priority ${priority}` : "");

/** @param {Job} job */
function place({ queue_position: position }) {
  if (!position) return "";
  return position === 1 ? "next in the queue" : `position ${position} in the queue`;
}

/** Seconds that the search for poses usually takes at most. */
const USUAL_S = 120;

const ORDINALS = ["first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth"];

/**
 * The search for poses: pairs matched by the current strategy, and the names of those tried so far.
 * @typedef {{ matched: { done: number, total: number } | null, strategies: string[] }} Search
 */

/**
 * The line beside a job's state; changes every second while it runs. `age` is the time since the
 * server reported the job, s.
 * @param {Job} job
 * @param {Search} search
 */
export function progressLine(job, search, age) {
  const runs = job.state === "running";
  const { matched } = search;
  const searches = runs && job.stage === "poses";
  const left = runs && job.eta_seconds ? job.eta_seconds - age : 0;
  return [
    doing(job),
    runs && job.steps_per_second ? `${job.steps_per_second.toFixed(1)} steps/s` : "",
    left > 0 ? `${duration(left)} left` : "",
    searches ? strategy(search) : "",
    searches && matched ? `${matched.done} of ${matched.total} photographs and pairs matched` : "",
    runs ? elapsed(job, search, left > 0) : "",
    attempt(job),
  ].filter(Boolean).join(" · ");
}

/**
 * A further attempt: the bar is its own, and the time since the first one is the job's.
 * @param {Job} job
 */
function attempt({ attempts, state, started_at: first }) {
  if (attempts < 2) return "";
  if (state !== "running" || !first) return `attempt ${attempts}`;
  const since = stopwatch((serverNow() - Date.parse(first)) / 1000);
  return `attempt ${attempts} (the bar shows its progress); ${since} since the first attempt began`;
}

/**
 * The strategy that follows others.
 * @param {Search} search
 */
function strategy({ strategies }) {
  const ordinal = ORDINALS[strategies.length - 1] ?? `${strategies.length}th`;
  return strategies.length > 1 ? `${ordinal} try: ${strategies.at(-1)}` : "";
}

/**
 * The time passed and, where the time left is unknown, how it compares with others.
 * @param {Job} job
 * @param {Search} search
 */
function elapsed(job, { strategies }, isKnown) {
  if (!job.stage_started_at) return "";
  const seconds = (serverNow() - Date.parse(job.stage_started_at)) / 1000;
  const time = stopwatch(seconds);
  if (job.stage !== "poses") return `${time} in this stage`;
  if (isKnown || job.options.pose_source === "given") return `${time} so far`;
  const isLong = seconds > USUAL_S || strategies.length > 2;
  return `${time} so far; ${isLong ? "longer than usual" : "usually one to two minutes"}`;
}

/**
 * The preset's name, with the detail that the machine chose and the limit of time.
 * @param {Job} job
 * @param {boolean} hasReason Whether it says why the machine chose that.
 */
export function presetOf({ preset, detail, options: { minutes } }, hasReason = false) {
  const chosen = detail ? `: ${detail.level}${hasReason ? ` (${detail.because})` : ""}` : "";
  // Within a limit the numbers are not the preset's.
  const limit = Number.isInteger(minutes) ? `, at most ${count(minutes, "minute")}` : "";
  return preset + chosen + limit;
}

/**
 * Time from the first attempt to the end; empty before that. Stage times may be longer, as they
 * include poses that an earlier job found.
 * @param {Job} job
 */
export const took = (job) => (seconds(job) > 0 ? duration(seconds(job)) : "");

/**
 * The same in seconds; 0 before the end.
 * @param {Job} job
 */
export const seconds = ({ started_at: from, finished_at: to }) =>
  from && to ? Math.max(1e-3, (Date.parse(to) - Date.parse(from)) / 1000) : 0;

/**
 * Whether a finished job took its poses from an earlier one. Its first stage then has that job's
 * time, so its stages sum to more time than it took.
 * @param {Job} job
 */
export const reusedPoses = (job) =>
  isOver(job) && seconds(job) > 0 && job.stages.reduce((sum, stage) => sum + stage.seconds, 0) > seconds(job);

/**
 * Sets a bar; one without progress is indeterminate, not at 0 %.
 * @param {HTMLProgressElement} bar
 * @param {Job} job
 */
export function setBar(bar, job) {
  if (job.state === "running" && job.progress === 0) bar.removeAttribute("value");
  else bar.value = job.progress;
}

/**
 * Why it failed: what happened, then what to do, which some failures already include.
 * @param {import("fled-api").JobError} error
 */
export function failure({ code, detail, hint }) {
  const advice = hint && !detail.includes(hint.replace(/\.$/, "")) ? `\n${hint}` : "";
  return `${plain(code)}: ${detail}${advice}`;
}

/**
 * The tags of a job.
 * @param {import("fled-api").Job} job
 */
export const tagList = (job) => job.tags.map((tag) => h("span", { class: "tag" }, tag));
