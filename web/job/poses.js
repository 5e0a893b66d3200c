// The positions of the photographs, and why some have none.

import { h } from "../lib/dom.js";
import { told } from "../lib/table.js";
import { hasWebGl } from "../lib/webgl.js";

const WORDS = {
  registered: "placed",
  given: "kept at its given position: its matches cannot place it",
  late: "placed with the scene",
  doubtful: "excluded: stronger matches contradict it",
  taken_out: "removed: it does not look like the scene from there",
  not_found: "not placed",
};

export function poses(base, report) {
  const rows = places(report);
  // If the browser draws the scene, it also draws the cameras.
  return h("div", { class: "poses" }, !hasWebGl() && map(base),
    rows.length > 0 && h("details", {}, h("summary", {}, summary(rows)), table(rows)));
}

function map(base) {
  const image = h("img", { src: `${base}/artifacts/poses.svg`, alt: "Cameras and sparse points from above", loading: "lazy" });
  const figure = h("figure", {}, image, h("figcaption", {}, "Where the photographs were taken from"));
  // Older runs have no such file.
  image.addEventListener("error", () => figure.remove());
  return figure;
}

/**
 * The position of each view in words, by its name.
 * @returns {Map<string, string>}
 */
export const positions = (report) => new Map(places(report).map(({ name, status }) => [name, WORDS[status] ?? status]));

/** A row per photograph: the result of structure from motion, and the fit to the last scene. */
function places(report) {
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

function summary(rows) {
  const count = (...states) => rows.filter((row) => states.includes(row.status)).length;
  const late = count("late");
  const parts = [`${count("registered", "given")} placed`, late > 0 && `${late} placed with the scene`,
    count("doubtful", "taken_out", "not_found") > 0 && `${count("doubtful", "taken_out", "not_found")} not placed`];
  return `Positions of the photographs: ${parts.filter(Boolean).join(", ")}`;
}

const COLUMNS = [{ title: "Photograph" }, { title: "Position" }, { title: "Consistent matches", class: "word" }, { title: "Error, px", class: "word" },
  { title: "Similarity to render", class: "word" }];

function table(rows) {
  const number = (value) => (value === null || value === undefined ? "" : value.toFixed(2));
  return told(COLUMNS, rows.map((row) => [row.name, WORDS[row.status] ?? row.status,
    row.matches > 0 ? `${row.fitting} of ${row.matches}` : "", number(row.error_px), number(row.fit)]));
}
