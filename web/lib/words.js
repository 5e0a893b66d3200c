// What numbers and failures mean, in a sentence for people.

import { h } from "./dom.js";

/** Of scores: title, what is better, what it means, and how it is written. */
export const METRICS = {
  psnr_cc: {
    title: "PSNR after colour fit, dB",
    better: "higher",
    digits: 2,
    means:
      "How close pictures are to the sharp truth once their overall colours agree (psnr_cc): " +
      "one decibel more is an error about a tenth smaller.",
  },
  ssim: {
    title: "SSIM",
    better: "higher",
    digits: 3,
    means:
      "How alike edges and textures are to the truth, 1 being the same picture: " +
      "it notices a blur that PSNR forgives.",
  },
  own_psnr: {
    title: "Self-consistency, PSNR, dB",
    better: "higher",
    digits: 2,
    means:
      "How well renders agree with the deblurred photographs that fled made itself: " +
      "agreement, not truth, since both can be wrong in the same way.",
  },
  own_ssim: {
    title: "Self-consistency, SSIM",
    better: "higher",
    digits: 3,
    means:
      "The same agreement, of edges and textures: a scene that is blurred like its own " +
      "deblurred photographs scores well, too.",
  },
  noise: {
    title: "Noise of renders",
    better: "lower",
    digits: 4,
    means: "How much grain is left in the renders; low noise is good only where detail stays.",
  },
  seconds: {
    title: "Time of the round, s",
    better: "lower",
    digits: 0,
    means: "How long the round took on this machine; other jobs beside it make it longer.",
  },
  gaussians: {
    title: "Gaussians",
    better: null,
    digits: 0,
    means:
      "How many splats the scene is made of: more hold finer detail in a larger file, " +
      "so neither way is better.",
  },
};

/** Of numbers that are told by round, and compared with nothing. */
const OTHERS = {
  shake: {
    title: "Shake found, px",
    better: null,
    means:
      "How far the camera moved within a photograph, in pixels of the training size: a mean " +
      "over all views.",
  },
  moved: {
    title: "Cameras moved, px",
    better: null,
    means:
      "How far the cameras were corrected, as seen in the pictures: much more than a pixel " +
      "means that their places were rough.",
  },
};

/** Of scores while a job trains: of three views at most, at half their size. */
const LIVE = {
  live_psnr: {
    title: "PSNR of held-out views",
    better: "higher",
    means:
      "How close renders of views that train nothing are to the sharp truth once their colours " +
      "agree, at half the size and before their cameras are corrected: a course to watch. The " +
      "round's own scores come when it is finished.",
  },
  live_ssim: {
    title: "SSIM of held-out views",
    better: "higher",
    means: "The same, of edges and textures, 1 being the same picture.",
  },
  live_own_psnr: {
    title: "Self-consistency, PSNR",
    better: "higher",
    means:
      "How well renders of views that train nothing, shaken as their photographs are, agree with " +
      "these photographs as fled brightened them, at half the size: noise that is in them is no " +
      "fault of the scene, and limits what can be reached.",
  },
  live_own_ssim: {
    title: "Self-consistency, SSIM",
    better: "higher",
    means: "The same agreement, of edges and textures.",
  },
};

/** Folded away beside numbers: what each of them means. */
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

/** What a failure's code means, and what one does about it. */
const FAILURES = {
  bad_input: [
    "the photographs or an option cannot be used",
    "What is named there cannot work; trying the same again will end the same way.",
  ],
  few_poses: [
    "too few photographs could be placed",
    "fled could not tell where enough of the photographs were taken from. More overlap and a " +
      "stiller camera help most; the same photographs will hardly do better.",
  ],
  oom_host: [
    "the machine ran out of memory",
    "The job needed more memory than the machine has; the same again will end the same way.",
  ],
  oom_gpu: [
    "the GPU ran out of memory",
    "The job needed more memory than the GPU has; the same again will end the same way.",
  ],
  device_lost: [
    "the GPU stopped answering",
    "The GPU's driver was reset, not by your photographs: try again, it goes on where it was.",
  ],
  io: [
    "a file could not be read or written",
    "The server's disk may be full or not writable: whoever runs it must look, then try again.",
  ],
  timeout: [
    "a step took too long",
    "The machine may have been overloaded: try again when it is less busy, it goes on where " +
      "it was.",
  ],
  environment: [
    "the server lacks something",
    "A program or model is missing on the server, not in your photographs: whoever runs it " +
      "must mend that, then try again.",
  ],
  internal: [
    "a fault of fled's own",
    "This is not your photographs' fault: try again, and report it with the log if it comes " +
      "back.",
  ],
};

/** A failure in a few words. */
export const failed = ({ code }) => FAILURES[code]?.[0] ?? String(code).replaceAll("_", " ");

/** What it means and what to do: a sentence or two; none for a code that is new. */
export const advice = ({ code }) => FAILURES[code]?.[1] ?? "";
