// The verdicts on the photographs of a capture.

import { count, h, prose } from "./dom.js";
import { told } from "./table.js";

const COLUMNS = [{ title: "Photograph" }, { title: "Size, px", class: "word" }, { title: "Focal length, px", class: "word" },
  { title: "Status" }, { title: "Warnings" }];

/** @typedef {import("fled-api").Capture} Capture */

/** @param {Capture} capture */
export const rejected = (capture) => capture.images.filter((image) => !image.accepted);

/**
 * "23 of 25 photographs are used".
 * @param {Capture} capture
 */
export const used = (capture) => `${capture.accepted} of ${count(capture.images.length, "photograph")} used`;

/**
 * Every photograph; those that are not used come first, with the reason.
 * @param {Capture} capture
 */
export function photographs(capture) {
  const images = [...capture.images].sort((a, b) => Number(a.accepted) - Number(b.accepted));
  return told(COLUMNS, images.map((image) => [
    image.name,
    image.width > 0 ? `${image.width} × ${image.height}` : "",
    image.focal_px ? image.focal_px.toFixed(0) : "",
    image.accepted ? "used" : h("span", { class: "bad" }, `not used: ${image.reason ?? "rejected"}`),
    image.warnings.map((warning) => warning.message).join("; "),
  ]));
}

/**
 * Warnings about all of them.
 * @param {Capture} capture
 */
export function captureWarnings(capture) {
  if (capture.warnings.length === 0) return null;
  return h("ul", { class: "plain" }, capture.warnings.map((warning) => h("li", {}, prose(warning.message))));
}

/**
 * For a job's page: which photographs of its upload were left out, and why.
 * @param {Capture} capture
 */
export function leftOut(capture) {
  const out = rejected(capture);
  if (out.length === 0) return null;
  return [
    h("p", {}, `${used(capture)}. Not used:`),
    h("ul", { class: "plain" }, out.map((image) => h("li", {}, h("b", {}, image.name), `: ${image.reason ?? "rejected"}`))),
  ];
}
