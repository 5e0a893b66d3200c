// How a job ran: time per stage, the resources used, every option.

import { duration, h, plain } from "../lib/dom.js";
import { reusedPoses } from "../lib/state.js";
import { optionName } from "../lib/words.js";

const STAGES = ["poses", "enhance", "deblur", "reconstruct", "render", "match", "evaluate"];

/** @param {import("fled-api").Job} job */
export function stageBars(job) {
  const isReused = reusedPoses(job);
  const taken = job.stages.filter((stage) => !isReused || stage.stage !== "poses");
  const rows = taken.sort((a, b) => a.round - b.round || STAGES.indexOf(a.stage) - STAGES.indexOf(b.stage));
  const most = Math.max(...rows.map((row) => row.seconds));
  const bars = h("div", { class: "bars" }, rows.flatMap((row) => [
    h("span", {}, row.round > 0 ? `${row.round} · ${row.stage}` : row.stage),
    h("progress", { max: most || 1, value: row.seconds, "aria-label": row.stage }),
    h("span", { class: "number" }, duration(row.seconds))]));
  if (rows.length === 0) return null;
  if (isReused) bars.prepend(h("span", {}, "poses"), h("span", { class: "soft" }, "reused from an earlier job"), h("span"));
  return Object.assign(bars, { gist: `mostly ${rows.find((row) => row.seconds === most).stage}` });
}

export function factList(report) {
  const placed = report.registered === undefined
    ? null : `${report.registered} of ${report.views}`;
  const list = pairs({
    "Photographs placed": placed,
    Shake: shake(report),
    Exposure: exposure(report.exposure),
    Detail: report.detail ? `${report.detail.level}, because ${report.detail.because}` : null,
    "Set by the run": Object.keys(report.in_effect ?? {}).length > 0 ? report.in_effect : null,
    "Trained on": report.adapter,
    // The photographs' positions have their own table.
    Poses: report.poses && without(report.poses, "verdicts"),
    Models: report.models,
    Fallbacks: report.fallbacks?.length > 0 ? report.fallbacks : null,
  });
  return Object.assign(list, { gist: placed ? `${placed} photographs placed` : "run details" });
}

/** The result of the look for shake before the rounds. */
function shake({ shaken_views: shaken, capture_shake: capture, registered }) {
  if (shaken === undefined || shaken === null) return null;
  const ways = {
    still: ", so the run uses plain splatting",
    // Reports of earlier versions.
    soft: ", and most are slightly soft, so the scene is trained on the views that the network deblurred",
    shaken: ", so blur kernels model the shake of each view that shows one",
  };
  return `${shaken} of ${registered} views are shaken${ways[capture] ?? ""}`;
}

/** How exposures differ and how they were corrected, with each view's values below. */
function exposure(found) {
  if (!found) return null;
  const [least, most] = found.spread_stops.map(stops);
  const views = Object.entries(found.views).map(([name, { stops: light, tint, seconds, iso }]) => {
    const taken = seconds && iso ? `; ${seconds < 1 ? `1/${Math.round(1 / seconds)}` : seconds} s, ISO ${iso}` : "";
    return [name, `${stops(light)} stops, red ${stops(tint[0])}, blue ${stops(tint[1])}${taken}`];
  });
  return { "In all": `${least} to ${most} stops; ${found.verdict}`, ...Object.fromEntries(views) };
}

const stops = (value) => `${value < 0 ? "\u2212" : "+"}${Math.abs(value).toFixed(2)}`;

function without(values, name) {
  const rest = Object.entries(values).filter(([key]) => key !== name);
  return rest.length > 0 ? Object.fromEntries(rest) : null;
}

/**
 * Every option of a job, one per line.
 * @param {import("fled-api").Job} job
 */
export const optionList = (job) => h("details", {}, h("summary", {}, `All ${Object.keys(job.options).length} options`), pairs(Object.fromEntries(Object.entries(job.options).map(([key, value]) => [optionName(key), value]).sort())));

/** Names and values; a nested value becomes its own list. */
function pairs(values) {
  const real = Object.entries(values).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return h("dl", {}, real.flatMap(([name, value]) => [h("dt", {}, plain(name)), h("dd", {}, shown(value))]));
}

/** Significant digits of a measured number. */
const DIGITS = 4;

function shown(value) {
  if (typeof value === "number" && !Number.isInteger(value)) return String(Number(value.toPrecision(DIGITS)));
  if (Array.isArray(value)) return h("ul", { class: "plain" }, value.map((one) => h("li", {}, shown(one))));
  return typeof value === "object" ? pairs(value) : String(value);
}
