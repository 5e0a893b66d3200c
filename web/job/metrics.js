// The scores of a job, round by round.

import { chart } from "../lib/chart.js";
import { duration, fold, h, plain } from "../lib/dom.js";
import { told } from "../lib/table.js";
import { meanings } from "../lib/words.js";

/** Against ground truth it is quality; against our own images it is only self-consistency. */
export function metricCharts(rounds) {
  const groups = [
    ["Against ground truth", ["gt"], "final"],
    ["Self-consistency: renders against fled's own deblurred views, not quality", ["deblurred"], "native"],
  ];
  const nodes = [];
  for (const [label, references, brightness] of groups) {
    const series = lines(rounds, references, brightness);
    if (series.length === 0) continue;
    const values = (key) => series
      .map((one) => ({ ...one, points: one.records.map(([round, record]) => [round, record[key]]).filter(([, v]) => Number.isFinite(v)) }))
      .filter((one) => one.points.length > 0);
    const isTruth = references[0] === "gt";
    const psnr = isTruth ? "psnr_cc_db" : "psnr_db";
    const title = psnr === "psnr_cc_db" ? "PSNR after colour fit, dB" : "PSNR, dB";
    const part = [
      h("div", { class: "charts" }, chart(title, values(psnr), 1), chart("SSIM", values("ssim"), 2, 1)),
      meanings(isTruth ? ["psnr_cc", "ssim"] : ["own_psnr", "own_ssim"])];
    // Where there is no truth the second group is the first.
    if (nodes.length > 0) nodes.push(fold(label, ...part));
    else nodes.push(h("h3", {}, label), ...part);
  }
  if (!nodes.some((node) => node.textContent.includes("ground truth"))) {
    nodes.push(h("p", { class: "hint" }, "This capture has no ground truth. The scores show how well the scene agrees with its own training images."));
  }
  nodes.push(fold("Round by round", roundTable(rounds),
    meanings(["noise", "shake", "moved", "seconds", "gaussians"])));
  return nodes;
}

function lines(rounds, references, brightness) {
  const series = [];
  for (const [colour, image, label] of [[0, "render", "rendered"], [1, "deblurred", "deblurred"], [2, "enhanced", "enhanced only"]]) {
    for (const [split, dashed] of [["held_out", false], ["train", true]]) {
      const records = rounds.flatMap((round) => {
        const record = recordOf(round, { image, split, references, brightness });
        return record ? [[round.round, record]] : [];
      });
      if (records.length > 0) series.push({ label: `${label}, ${plain(split)} (${records[0][1].views} views)`, colour, dashed, records });
    }
  }
  return series;
}

/** The scores in a round of one kind of picture; `undefined` where there are none. */
export function recordOf(round, { image, split, references, brightness }) {
  const fits = round.records.filter((r) => r.image === image && r.split === split && references.includes(r.reference));
  // Where the wanted brightness was not measured, the other one is better than nothing.
  return fits.find((r) => r.brightness === brightness) ?? fits[0];
}

const COLUMNS = ["Round", "Time", "Gaussians", "Steps", "Steps/s", "Render noise", "Shake, px", "Camera correction, px", "Note"]
  .map((title) => ({ title }));

function roundTable(rounds) {
  const cells = (round) => [round.round, duration(round.seconds), round.gaussians.toLocaleString(), round.steps.toLocaleString(),
    round.steps_per_second?.toFixed(1), round.noise_sigma?.render?.toFixed(4) ?? round.noise_sigma?.renders?.toFixed(4) ?? "",
    round.shake_px?.toFixed(2), round.pose_correction_px?.toFixed(2), round.worse_than_previous ? "worse than the previous round" : ""];
  return told(COLUMNS, rounds.map((round) => cells(round).map((text) => String(text ?? ""))));
}
