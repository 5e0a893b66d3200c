// The results of checking a capture's photographs.

import { address, count, h, prose } from "./dom.js";
import { staticTable } from "./table.js";

const COLUMNS = [{ title: "Picture", class: "pictured", head: h("span", { class: "heard" }, "Picture") }, { title: "Photograph" }, { title: "Size, px", class: "word" }, { title: "Focal length, px", class: "word" }, { title: "Colours", class: "word" },
  { title: "Brightness", class: "word" }, { title: "Sharpness", class: "word" }, { title: "Position" }, { title: "Status" }, { title: "Warnings" }];

/** @typedef {import("fled-api").Capture} Capture */

/** @param {Capture} capture */
export const rejected = (capture) => capture.images.filter((image) => !image.accepted);

/**
 * "23 of 25 photographs are used".
 * @param {Capture} capture
 */
export const used = (capture) => `${capture.accepted} of ${count(capture.images.length, "photograph")} used`;

/** Target mean of a thumbnail, and the largest gain used to reach it. */
const [SHOWN, MOST] = [0.4, 12];

/**
 * A thumbnail, brightened to be visible; empty if the server has none.
 * @param {Capture} capture
 * @param {Capture["images"][number]} image
 */
export function thumbnail(capture, { name, brightness }) {
  if (brightness === undefined) return null;
  const image = h("img", { alt: "", loading: "lazy", src: `v1/captures/${capture.id}/thumbnails/${address(name)}` });
  image.style.filter = `brightness(${Math.min(MOST, Math.max(1, SHOWN / Math.max(brightness, 1e-3))).toFixed(2)})`;
  image.addEventListener("error", () => image.remove());
  return image;
}

/**
 * The used photographs in a row, shown while a job has nothing else to show.
 * @param {Capture} capture
 */
export function strip(capture) {
  return h("div", { class: "photographs", tabIndex: 0, role: "group", "aria-label": "Photographs" },
    capture.images.filter((image) => image.accepted).map((image) => thumbnail(capture, image)));
}

/** A thumbnail that opens the photograph as uploaded. */
function opening(capture, image) {
  const picture = thumbnail(capture, image);
  if (!picture) return "";
  const href = `v1/captures/${capture.id}/photographs/${address(image.name)}`;
  return h("a", { href, target: "_blank", "aria-label": `Open ${image.name}` }, picture);
}

/**
 * Every photograph, unused ones first with the reason. Brightness is a share of white, sharpness a
 * share of the median.
 * @param {Capture} capture
 * @param {Map<string, string>} positions a job's result for each view
 */
export function photographs(capture, positions = new Map()) {
  const images = [...capture.images].sort((a, b) => Number(a.accepted) - Number(b.accepted));
  const share = (value) => (value === undefined ? "" : `${(100 * value).toFixed(0)} %`);
  return staticTable(COLUMNS, images.map((image) => [
    opening(capture, image),
    image.name,
    image.width > 0 ? `${image.width} × ${image.height}` : "",
    image.focal_px ? image.focal_px.toFixed(0) : "",
    image.colours ?? (image.accepted ? "sRGB" : ""),
    share(image.brightness),
    share(image.sharpness),
    positions.get(image.view) ?? "",
    image.accepted ? "used" : h("span", { class: "bad" }, `not used: ${image.reason ?? "rejected"}`),
    image.warnings.map((warning) => warning.message).join("; "),
  ]));
}

/**
 * Warnings about the whole capture.
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
