// The photographs of a job that found too little overlap: which match one another, and which do not.

import { count, h, s } from "../lib/dom.js";
import { thumbnail } from "../lib/photographs.js";

/** Width of a thumbnail and the gaps beside it, in a group and between groups, px. */
const [WIDTH, GAP, APART] = [92, 6, 26];
/** Height of the links above the thumbnails, px. */
const ARCS = 64;
/** Widest line, px: of the pair with most matches. */
const WIDEST = 6;

/** @typedef {import("fled-api").Overlap} Overlap */

/**
 * The groups as thumbnails, with arcs between photographs that match.
 * @param {import("fled-api").Capture} capture
 * @param {Overlap} overlap
 */
export function overlapMap(capture, overlap) {
  const groups = overlap.groups.filter((group) => group.length > 1);
  const alone = overlap.groups.filter((group) => group.length === 1).flat();
  const columns = [...groups, ...(alone.length > 0 ? [alone] : [])];
  const image = new Map(capture.images.map((one) => [one.view, one]));
  const name = (view) => image.get(view)?.name ?? view;
  const middles = new Map();
  let left = 0;
  for (const views of columns) {
    for (const view of views) {
      middles.set(view, left + WIDTH / 2);
      left += WIDTH + GAP;
    }
    left += APART - GAP;
  }
  const picture = (view) => h("span", { title: name(view) }, image.has(view) && thumbnail(capture, image.get(view)));
  const column = (views, words) => h("figure", { "aria-label": views.map(name).join(", ") }, h("div", {}, views.map(picture)), h("figcaption", {}, words));
  return [
    h("p", {}, sentence(groups, alone)),
    h("div", { class: "overlap", tabIndex: 0, role: "group", "aria-label": "Groups of photographs that match" },
      arcs(overlap, middles, left - APART, name),
      h("div", { class: "groups" }, groups.map((views) => column(views, count(views.length, "photograph"))),
        alone.length > 0 && column(alone, groups.length > 0 ? "match no other" : "match one another too little"))),
    h("p", { class: "hint" }, nearest(overlap, name),
      " Each photograph should show most of what the one before it shows."),
  ];
}

/** @param {string[][]} groups @param {string[]} alone */
function sentence(groups, alone) {
  if (groups.length === 0) return "No two photographs show enough of the same things.";
  const words = groups.map((group) => `these ${group.length}`);
  const list = words.length > 1 ? `${words.slice(0, -1).join(", ")} and ${words.at(-1)}` : words[0];
  const others = alone.length > 0 ? `${count(alone.length, "photograph")} ${alone.length === 1 ? "matches" : "match"} no other` : "";
  if (groups.length === 1) return `Only ${list} match one another; ${others}. Take some in between.`;
  const text = `${list} have too little in common${others && `, and ${others}`}. Take some in between.`;
  return text[0].toUpperCase() + text.slice(1);
}

/** The strongest pair across groups: the place where new photographs help soonest. */
function nearest({ links }, name) {
  const sorted = links.toSorted((a, b) => b.matches - a.matches);
  const best = sorted.find((link) => !link.connects);
  if (!best) return "No photographs of different groups match at all.";
  const most = sorted[0].connects ? `, where the strongest pair has ${sorted[0].matches}` : "";
  return `Closest are ${name(best.first)} and ${name(best.second)}, with ${best.matches} matches${most}.`;
}

/** @param {Overlap} overlap */
function arcs({ links }, middles, width, name) {
  const most = Math.max(1, ...links.map((link) => link.matches));
  const svg = s("svg", { width, height: ARCS, viewBox: `0 0 ${width} ${ARCS}`, role: "img", "aria-label": "Links between the photographs" });
  for (const { first, second, matches, connects } of links) {
    const [from, to] = [middles.get(first), middles.get(second)];
    if (from === undefined || to === undefined) continue;
    const height = Math.min(2 * ARCS - 8, 24 + Math.abs(to - from) / 4);
    svg.append(s("path", { d: `M${from} ${ARCS}C${from} ${ARCS - height} ${to} ${ARCS - height} ${to} ${ARCS}`,
      class: connects ? "" : "weak", "stroke-width": Math.max(1, WIDEST * Math.sqrt(matches / most)).toFixed(1) },
    s("title", {}, `${name(first)} and ${name(second)}: ${matches} matches`)));
  }
  return svg;
}
