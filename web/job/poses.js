// The positions of the photographs, and why some have none.

import { h } from "../lib/dom.js";
import { hasWebGl } from "../lib/webgl.js";

const WORDS = {
  registered: "placed",
  given: "kept at its given position: its matches cannot place it",
  late: "placed with the scene",
  doubtful: "excluded: stronger matches contradict it",
  taken_out: "removed: it does not look like the scene from there",
  not_found: "not placed",
};

/** The position of a view in words. */
export const positionWord = (status) => WORDS[status] ?? status;

/** The cameras from above; if the browser draws the scene, it also draws the cameras. */
export function camerasMap(base) {
  if (hasWebGl()) return null;
  const image = h("img", { src: `${base}/artifacts/poses.svg`, alt: "Cameras and sparse points from above", loading: "lazy" });
  const figure = h("figure", {}, image, h("figcaption", {}, "Where the photographs were taken from"));
  // Older runs have no such file.
  image.addEventListener("error", () => figure.remove());
  return h("div", { class: "poses" }, figure);
}

/**
 * The position of each view in words, by its name.
 * @returns {Map<string, string>}
 */
export const positions = (report) => new Map(places(report).map(({ name, status }) => [name, positionWord(status)]));

/** A row per photograph: the result of structure from motion, and the fit to the last scene. */
export function places(report) {
  const verdicts = report.poses?.verdicts ?? [];
  const views = report.rounds.at(-1)?.views ?? [];
  const names = new Set([...verdicts, ...views].map((row) => row.name));
  const of = (rows, name) => rows.find((row) => row.name === name);
  return [...names].sort().map((name) => {
    const [verdict, view] = [of(verdicts, name), of(views, name)];
    const status = verdict?.status ?? (view?.registered ? "registered" : "not_found");
    return { name, status, ...verdict, fit: view?.fit ?? verdict?.fit };
  });
}
