// The scores of a job, round by round.

import { chart } from "../lib/chart.js";
import { duration, fold, h, plain } from "../lib/dom.js";
import { agreement, hasTruth, recordOf } from "./records.js";
import { staticTable } from "../lib/table.js";
import { METRICS, meanings } from "../lib/words.js";

export function metricCharts(rounds) {
  const isTruth = hasTruth(rounds);
  const lines = series(rounds, isTruth);
  const values = (key) => lines
    .map((one) => ({ ...one, points: one.records.map(([round, record]) => [round, record[key]]).filter(([, v]) => Number.isFinite(v)) }));
  const psnr = values("psnr_cc_db");
  if (!isTruth) {
    const points = rounds.map((round) => [round.round, agreement(round)]).filter(([, value]) => value);
    if (points.length > 0) psnr.unshift({ label: "rendered, shaken as photographed", colour: 1, dashed: false, records: [], points });
  }
  const keys = isTruth ? ["psnr_cc", "ssim"] : ["own_psnr", "own_ssim"];
  const drawn = [chart(METRICS[keys[0]].title, psnr, 1), chart(METRICS[keys[1]].title, values("ssim"), 2, 1)].filter(Boolean);
  return [
    h("h3", {}, isTruth ? "Against ground truth" : "Agreement with the photographs"),
    !isTruth && h("p", { class: "hint" }, "This capture has no ground truth. Renders are compared with the brightened photographs, which are noisy and shaken themselves: this is agreement, not quality."),
    drawn.length > 0 && h("div", { class: "charts" }, drawn),
    meanings(keys),
    fold("Round by round", roundTable(rounds), meanings(["noise", "shake", "moved", "seconds", "gaussians"])),
  ].filter(Boolean);
}

function series(rounds, isTruth) {
  const found = [];
  for (const [colour, image, label] of [[0, "render", "rendered"], [1, "deblurred", "deblurred"], [2, "enhanced", "enhanced only"]]) {
    for (const [split, dashed] of [["held_out", false], ["train", true]]) {
      const records = rounds.flatMap((round) => {
        const record = recordOf(round, { image, split }, isTruth);
        return record ? [[round.round, record]] : [];
      });
      if (records.length > 0) found.push({ label: `${label}, ${split === "train" ? "training" : plain(split)} (${records[0][1].views} views)`, colour, dashed, records });
    }
  }
  return found;
}

const COLUMNS = ["Round", "Time", "Gaussians", "Steps", "Steps/s", "Render noise", "Shake, px", "Camera correction, px", "Note"]
  .map((title) => ({ title }));

function roundTable(rounds) {
  const cells = (round) => [round.round, duration(round.seconds), round.gaussians.toLocaleString(), round.steps.toLocaleString(),
    round.steps_per_second?.toFixed(1), round.noise_sigma?.render?.toFixed(4) ?? round.noise_sigma?.renders?.toFixed(4) ?? "",
    round.shake_px?.toFixed(2), round.pose_correction_px?.toFixed(2), round.worse_than_previous ? "worse than the previous round" : ""];
  return staticTable(COLUMNS, rounds.map((round) => cells(round).map((text) => String(text ?? ""))));
}
