// The summary of a finished job, with its downloads and links.

import { h, size } from "../lib/dom.js";
import { leap } from "../lib/place.js";
import { took } from "../lib/state.js";
import { METRICS } from "../lib/words.js";
import { agreement, hasTruth, recordOf } from "./metrics.js";

/**
 * @param {import("fled-api").Job} job
 * @param {any} report The report of its rounds.
 * @param {{ name: string, bytes: number }[]} artifacts
 * @param {number | undefined} given Photographs of its capture, if known.
 * @param {HTMLElement | undefined} share The section that shares it, if any.
 */
export function summary(job, report, artifacts, given, share) {
  const best = report.rounds.find(({ round }) => round === report.best_round);
  const scene = artifacts.find(({ name }) => name === "scene.ply");
  const link = `/v1/jobs/${job.id}/artifacts/scene.ply`;
  const facts = [
    ["Delivered", best && `round ${best.round} of ${report.rounds.length}`],
    ...(best ? scores(best) : []),
    ["Total time", took(job)],
    ["Photographs used", report.registered !== undefined && `${report.registered} of ${given ?? report.views}`],
  ].filter(([, value]) => value);
  return h("div", { class: "summary" },
    h("dl", {}, facts.map(([name, value, more]) => h("div", {}, h("dt", {}, name), h("dd", {}, value, " ", more && h("span", { class: "soft" }, more))))),
    h("div", { class: "row" },
      scene && h("a", { class: "button main", href: link, download: "scene.ply" }, `Download scene, ${size(scene.bytes)}`),
      share && h("button", { type: "button", onclick: () => leap(share) }, "Share"),
      h("span", { class: "hint" }, "Job ID ", h("code", {}, job.id), " ", navigator.clipboard && copy(job.id))));
}

/** Scores of the delivered round beside those of the photographs: `[name, value, more]`. */
function scores(round) {
  if (!hasTruth([round])) {
    const own = agreement(round) ?? held(round, "render", false)?.psnr_cc_db;
    return [["Agreement with photographs", own && `${own.toFixed(METRICS.own_psnr.digits)} dB`]];
  }
  const [render, only] = ["render", "enhanced"].map((image) => held(round, image, true));
  const score = (name, key, { digits }, unit = "") => [
    name,
    render && render[key].toFixed(digits) + unit,
    only && `${render?.split === "train" ? "training views" : "held out"}; enhanced ${only[key].toFixed(digits)}`,
  ];
  return [score("PSNR", "psnr_cc_db", METRICS.psnr_cc, " dB"), score("SSIM", "ssim", METRICS.ssim)];
}

const held = (round, image, isTruth) =>
  recordOf(round, { image, split: "held_out" }, isTruth) ?? recordOf(round, { image, split: "train" }, isTruth);

/** Without TLS a page has no clipboard; the ID can be selected by hand. */
function copy(text) {
  const button = h("button", { type: "button", class: "small", "aria-label": "Copy job ID" }, "Copy");
  button.addEventListener("click", () =>
    navigator.clipboard.writeText(text).then(() => { button.textContent = "Copied"; }, () => { button.textContent = "Not copied"; }));
  return button;
}
