// The verdict on a finished job in plain words: its gain, what was found, and what was done.

import { count } from "../lib/dom.js";
import { agreement, hasTruth, recordOf } from "./records.js";

/** Every threshold of the verdict. */
export const LIMITS = {
  /** Gain over the brightened photographs, against ground truth, dB. */
  large: 2.5,
  clear: 1,
  /** A smaller loss counts as none, dB. */
  worse: -0.05,
  /** Agreement with the photographs, dB. */
  close: 26,
  fair: 20,
  /** Agreement this near the limit that the photographs' noise sets is close, dB. */
  limited: 3,
  /** A view's likeness to its photograph, 0 to 1, below which its position is in doubt. */
  alike: 0.5,
  /** Noise of clean photographs, standard deviation of 0 to 1. */
  clean: 0.008,
  /** A reduction of noise by this factor is worth a word. */
  weaker: 1.5,
  /** Differences of exposure and brightness that are visible, stops. */
  visible: 0.15,
};

const SPLITS = ["held_out", "train"];

/**
 * The delivered round; `undefined` before the first. Reports of earlier versions have no rows by
 * view.
 */
export function delivered(report) {
  const best = report.rounds.find(({ round }) => round === report.best_round);
  return best && { ...best, views: best.views ?? [], noise_sigma: best.noise_sigma ?? {} };
}

/**
 * `{ tone, figure, words, note, views, of, isTruth }`: `tone` is `good`, `little` or `worse`,
 * `figure` the one number in dB, `words` what it means, `note` on its reference, and `views` the
 * names of those, of `of` compared ones, that are worse than (with ground truth), or unlike, their
 * photographs. `null` if a report of an earlier version lacks the scores.
 * @param {any} report The report of a job's rounds.
 */
export function verdict(report) {
  const best = delivered(report);
  if (!best) return null;
  return hasTruth([best]) ? byTruth(report, best) : byAgreement(report, best);
}

function byTruth(report, best) {
  const gain = gainOf(best);
  if (gain === undefined) return null;
  const compared = best.views.filter((view) => gained(view) !== undefined);
  const views = compared.filter((view) => gained(view) < LIMITS.worse).map(({ name }) => name);
  const figure = `${Math.abs(gain).toFixed(1)} dB`;
  const note = "Compared with the ground truth of this capture.";
  const found = { figure, note, views, of: compared.length, isTruth: true };
  const judged = (tone, words) => ({ ...found, tone, words });
  if (gain < LIMITS.worse) return judged("worse", "worse than brightening alone");
  if (gain >= LIMITS.large) return judged("good", "better than brightening alone: a large gain");
  if (gain >= LIMITS.clear) return judged("good", "better than brightening alone: a clear gain");
  const words = ["better than brightening alone: little gain", already(report, best)];
  return judged("little", words.filter(Boolean).join("; "));
}

function byAgreement(report, best) {
  const score = agreement(best) ?? recordIn(best, "render", false)?.psnr_cc_db;
  if (score === undefined) return null;
  const compared = best.views.filter(({ fit }) => Number.isFinite(fit));
  const views = compared.filter(({ fit }) => fit < LIMITS.alike);
  const isClose = score >= LIMITS.close || score >= best.noise_ceiling_db - LIMITS.limited;
  const [tone, words] = isClose ? ["good", "the scene matches the photographs closely"]
    : score >= LIMITS.fair ? ["little", "the scene matches the photographs roughly"]
      : ["worse", "the scene matches the photographs poorly"];
  const why = tone === "little" && already(report, best);
  return {
    tone,
    figure: `${score.toFixed(1)} dB`,
    words: [words, why && `${why}, so there was little to gain`].filter(Boolean).join("; "),
    note: "Without ground truth this measures agreement with the photographs, not quality.",
    views: views.map(({ name }) => name),
    of: compared.length,
    isTruth: false,
  };
}

/** The render's gain over the brightened photograph, mean of the views, dB. */
function gainOf(best) {
  for (const split of SPLITS) {
    const [render, only] = ["render", "enhanced"].map((image) => recordOf(best, { image, split }, true));
    if (render && only) return render.psnr_cc_db - only.psnr_cc_db;
  }
  return undefined;
}

const recordIn = (round, image, isTruth) =>
  SPLITS.map((split) => recordOf(round, { image, split }, isTruth)).find(Boolean);

/**
 * The same gain of one view, dB; `undefined` without ground truth.
 * @param {import("fled-api").ViewScore} view
 */
export function gained({ reference, psnr_cc_db: render, photograph_psnr_cc_db: only }) {
  const isKnown = reference === "gt" && Number.isFinite(render) && Number.isFinite(only);
  return isKnown ? render - only : undefined;
}

/** Why there was little to gain, if the photographs are the reason. */
function already(report, best) {
  const isClean = best.noise_sigma.enhanced < LIMITS.clean;
  const words = [shakenIn(report) === 0 && "sharp", isClean && "clean"].filter(Boolean);
  if (!isClean) return "";
  return `the photographs were already ${words.join(" and ")}`;
}

const shakenIn = ({ shaken_views: shaken }) => shaken ?? undefined;

/** What was found in the photographs: phrases. */
export function found(report) {
  const best = delivered(report);
  if (!best) return [];
  // The last round has the target brightness; the delivered one may be darker.
  const dark = light(report.rounds.at(-1));
  return [placed(report), shake(report, best), exposures(report), dark].filter(Boolean);
}

function placed({ registered, views }) {
  return registered < views ? `${registered} of ${views} photographs could be placed` : "";
}

function shake(report, best) {
  const shaken = shakenIn(report);
  if (shaken === undefined) return "";
  if (shaken === 0) return "no photograph is shaken";
  const most = Math.max(0, ...best.views.filter((view) => view.is_shaken).map((view) => view.shake_px));
  const far = most >= 1 ? `, by up to ${most.toFixed(0)} px` : "";
  return `${shaken} of ${count(report.registered, "photograph")} ${shaken === 1 ? "is" : "are"} shaken${far}`;
}

const spread = ({ exposure }) =>
  exposure ? exposure.spread_stops[1] - exposure.spread_stops[0] : 0;

function exposures(report) {
  if (!report.exposure) return "";
  const differ = spread(report);
  return differ < LIMITS.visible ? "exposures are equal"
    : `exposures differ by up to ${stops(differ)}`;
}

const light = ({ anchor }) =>
  anchor?.ev > LIMITS.visible ? `the photographs are ${stops(anchor.ev)} too dark` : "";

const stops = (value) => `${value.toFixed(1)} ${value.toFixed(1) === "1.0" ? "stop" : "stops"}`;

/** What was done about it: phrases. */
export function done(report) {
  const best = delivered(report);
  if (!best) return [];
  const { enhanced, render } = best.noise_sigma;
  const weaker = enhanced / render;
  // A blurred scene has little noise, too.
  const isMerit = verdict(report)?.tone !== "worse" && Number.isFinite(weaker);
  return [
    best.anchor?.ev > LIMITS.visible && `brightened by ${stops(best.anchor.ev)}`,
    spread(report) >= LIMITS.visible &&
      (report.exposure.share > 0 ? "exposures evened out" : "exposures left as taken"),
    best.kernels > 0 && `the shake of ${count(best.kernels, "photograph")} corrected`,
    isMerit && weaker >= LIMITS.weaker &&
      `noise reduced ${weaker.toFixed(weaker < 10 ? 1 : 0)} times`,
  ].filter(Boolean);
}

/**
 * Names of the views with the best, a typical and the poorest gain, or score if none has ground
 * truth: gains and scores do not compare.
 */
export function notable(report) {
  const views = (delivered(report) ?? report.rounds.at(-1))?.views ?? [];
  const isTruth = views.some((view) => gained(view) !== undefined);
  const scored = views
    .map((view) => ({ name: view.name, score: isTruth ? gained(view) : view.psnr_cc_db }))
    .filter(({ score }) => Number.isFinite(score));
  if (scored.length === 0) return null;
  const sorted = scored.toSorted((a, b) => a.score - b.score);
  const middle = sorted[Math.floor(sorted.length / 2)].score;
  return {
    typical: scored.find(({ score }) => score === middle).name,
    best: sorted.at(-1).name,
    poorest: sorted[0].name,
  };
}
