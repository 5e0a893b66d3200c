// Names and meanings of options, scores and failures.

import { h, plain } from "./dom.js";

const OPTIONS = {
  size: "Image size",
  target: "Brightness",
  held_out: "Held-out views",
  minutes: "Time limit, minutes",
  steps: "Training steps",
  cap: "Maximum Gaussians",
  pose_source: "Camera poses",
  refine_poses: "Refine cameras",
  late_views: "Place missing photographs later",
  sh_degree: "Spherical harmonics degree",
  deblur: "Deblurring network",
  densify: "Densification",
  seed: "Random seed",
  train_on: "Training views",
  start: "Start of later rounds",
  deliver: "Delivered round",
};

/** The name of an option on every page. */
export const optionName = (key) => OPTIONS[key] ?? plain(key)[0].toUpperCase() + plain(key).slice(1);

/** Scores: title, better direction, meaning, and format. */
export const METRICS = {
  psnr_cc: {
    title: "PSNR after colour fit, dB",
    better: "higher",
    digits: 2,
    means:
      "How close pictures are to the sharp ground truth once their overall colours match " +
      "(psnr_cc). One decibel more means an error about a tenth smaller.",
  },
  ssim: {
    title: "SSIM",
    better: "higher",
    digits: 3,
    means:
      "How closely edges and textures match the ground truth; 1 means identical pictures. " +
      "SSIM notices blur that PSNR forgives.",
  },
  own_psnr: {
    title: "PSNR with the photographs, dB",
    better: "higher",
    digits: 2,
    means:
      "How well renders, each shaken like its photograph, agree with the photographs that fled " +
      "brightened, at one brightness for all rounds. By default fled delivers the best round by this score. " +
      "Without that shake a sharp render agrees less with a shaken photograph.",
  },
  own_ssim: {
    title: "SSIM with the photographs",
    better: "higher",
    digits: 3,
    means:
      "The same agreement for edges and textures, of renders without shake. Noise and blur in the " +
      "photographs lower it.",
  },
  noise: {
    title: "Render noise",
    better: "lower",
    digits: 4,
    means: "How much grain is left in the renders. Low noise is good only if detail remains.",
  },
  seconds: {
    title: "Round time, s",
    better: "lower",
    digits: 0,
    means: "How long the round took on this machine. Other jobs running at the time slow it down.",
  },
  gaussians: {
    title: "Gaussians",
    better: null,
    digits: 0,
    means:
      "How many Gaussians the scene consists of. More can hold finer detail but make a larger " +
      "file, so neither more nor fewer is better.",
  },
};

/** Numbers shown by round but not compared. */
const OTHERS = {
  shake: {
    title: "Shake, px",
    better: null,
    means:
      "How far the camera moved during an exposure, in pixels at the training size, averaged " +
      "over all views.",
  },
  moved: {
    title: "Camera correction, px",
    better: null,
    means:
      "How far the cameras were corrected, measured in the pictures. Much more than a pixel " +
      "means that the initial poses were rough.",
  },
};

/** Scores while a job trains, of at most three views at half size. */
const LIVE = {
  live_psnr: {
    title: "PSNR of held-out views",
    better: "higher",
    means:
      "How close renders of held-out views are to the sharp ground truth once their colours " +
      "match, at half size and before their cameras are corrected. Use it to follow progress; " +
      "final scores appear when the round finishes.",
  },
  live_ssim: {
    title: "SSIM of held-out views",
    better: "higher",
    means: "The same for edges and textures; 1 means identical pictures.",
  },
  live_own_psnr: {
    title: "Agreement, PSNR",
    better: "higher",
    means:
      "How well renders of held-out views, shaken like their photographs, agree with those " +
      "photographs as brightened by fled, at half size. Noise in the photographs is not the " +
      "scene's fault and limits the score that can be reached.",
  },
  live_own_ssim: {
    title: "Agreement, SSIM",
    better: "higher",
    means: "The same agreement for edges and textures.",
  },
};

/** The meanings of numbers, folded away beside them. */
export function meanings(keys) {
  const of = (key) => METRICS[key] ?? OTHERS[key] ?? LIVE[key];
  return h(
    "details",
    { class: "meanings" },
    h("summary", {}, "What these numbers mean"),
    h(
      "dl",
      {},
      keys
        .map(of)
        .flatMap((metric) => [
          h("dt", {}, metric.title),
          h("dd", {}, metric.means, " ", direction(metric)),
        ]),
    ),
  );
}

/** "Higher is better." */
export const direction = ({ better }) =>
  better ? `${better === "higher" ? "Higher" : "Lower"} is better.` : "";

/** Meaning and remedy of each failure code. */
const FAILURES = {
  bad_input: [
    "a photograph or an option cannot be used",
    "Something named above cannot be used. Trying again without changing it will fail again.",
  ],
  few_poses: [
    "too few photographs could be placed",
    "fled could not work out where enough of the photographs were taken. More overlap and a " +
      "steadier camera help most; trying the same photographs again rarely helps.",
  ],
  oom_host: [
    "the machine ran out of memory",
    "The job needed more memory than the machine has. The same job would fail again.",
  ],
  oom_gpu: [
    "the GPU ran out of memory",
    "The job needed more memory than the GPU has. The same job would fail again.",
  ],
  device_lost: [
    "the GPU stopped responding",
    "The GPU driver was reset; your photographs are not the cause. Try again: the job continues " +
      "where it stopped.",
  ],
  io: [
    "a file could not be read or written",
    "The server's disk may be full or read-only. Ask the server's administrator to check it, " +
      "then try again.",
  ],
  timeout: [
    "a step took too long",
    "The machine may have been overloaded. Try again when it is less busy: the job continues " +
      "where it stopped.",
  ],
  environment: [
    "the server is missing a program or model",
    "Your photographs are not the cause. Ask the server's administrator to install what is " +
      "missing, then try again.",
  ],
  internal: [
    "an internal error",
    "Your photographs are not the cause. Try again; if it happens again, report it together " +
      "with the log.",
  ],
};

/** A failure in a few words. */
export const failed = ({ code }) => FAILURES[code]?.[0] ?? String(code).replaceAll("_", " ");

/** Its remedy: a sentence or two; empty for an unknown code. */
export const advice = ({ code }) => FAILURES[code]?.[1] ?? "";
