// The summary of a finished job: the verdict, what was found and done, its downloads and links.

import { count, h, size } from "../lib/dom.js";
import { explained } from "../lib/download.js";
import { leap } from "../lib/place.js";
import { shapingQuery } from "../lib/shaping.js";
import { took } from "../lib/state.js";
import { done, found, verdict } from "./verdict.js";

/** Views named in the verdict; the list of views has the rest. */
const NAMED = 5;

/**
 * @param {import("fled-api").Job} job
 * @param {any} report The report of its rounds.
 * @param {{ name: string, bytes: number }[]} artifacts
 * @param {number | undefined} given Photographs of its capture, if known.
 * @param {HTMLElement | undefined} share The section that shares it, if any.
 * @param {(name: string) => void} open Shows the pictures of a view.
 * @param {ReturnType<import("../lib/shaping.js").newShaping>} shaping
 */
export function summary(job, report, artifacts, given, share, open, shaping) {
  const scene = artifacts.find(({ name }) => name === "scene.ply");
  const facts = [
    ["Total time", took(job)],
    ["Photographs used", report.registered !== undefined && `${report.registered} of ${given ?? report.views}`],
    ["Delivered", report.best_round && `round ${report.best_round} of ${report.rounds.length}`],
  ].filter(([, value]) => value);
  return h("div", { class: "summary" },
    verdictOf(report, open),
    h("dl", {}, facts.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value)))),
    h("div", { class: "row" },
      scene && download(`v1/jobs/${job.id}`, scene, shaping),
      share && h("button", { type: "button", onclick: () => leap(share) }, "Share"),
      h("span", { class: "hint" }, "Job ID ", h("code", {}, job.id), " ", navigator.clipboard && copy(job.id))));
}

/** The link to the scene, as the user has shaped it, and a note of why it is refused. */
function download(base, { bytes }, shaping) {
  const link = h("a", { class: "button main", download: "scene.ply" });
  const note = h("p", { class: "note", role: "status" });
  const end = explained(link, note, () => shaping.now.crop !== null);
  const show = () => {
    const { crop, scale } = shaping.now;
    const query = shapingQuery({ crop, scale });
    const href = `${base}/${query ? "exports" : "artifacts"}/scene.ply${query}`;
    if (href !== link.getAttribute("href")) end();
    link.href = href;
    // A cropped file is made while being sent: its size is not known.
    const kind = `${crop ? "cropped " : ""}scene${scale !== null ? " in metres" : ""}`;
    link.textContent = `Download ${kind}${crop ? "" : `, ${size(bytes)}`}`;
  };
  show();
  // A newer summary takes the place of this one.
  const deaf = shaping.heard(() => (link.isConnected ? show() : deaf()));
  return [link, note];
}

function verdictOf(report, open) {
  const judged = verdict(report);
  const line = (title, phrases) => phrases.length > 0 &&
    h("p", {}, h("b", {}, title), " ", sentence(phrases));
  return h("div", { class: "verdict" },
    judged && h("p", { class: `judged ${judged.tone}` }, h("strong", {}, judged.figure), " ", judged.words),
    judged && judged.views.length > 0 && exceptions(judged, open),
    line("Found:", found(report)), line("Done:", done(report)),
    judged && h("p", { class: "hint" }, judged.note));
}

/** The views to look at, each with its pictures. */
function exceptions({ views, of, isTruth }, open) {
  const words = isTruth ? "Worse than the photographs" : "Unlike the photographs";
  const links = views.slice(0, NAMED).flatMap((name, i) => [
    i > 0 ? ", " : "", h("button", { type: "button", class: "link", onclick: () => open(name) }, name)]);
  return h("p", { class: "bad" }, `${words} in ${views.length} of ${count(of, "view")}: `,
    links, views.length > NAMED ? ", …" : "");
}

function sentence(phrases) {
  const text = phrases.join("; ");
  return `${text[0].toUpperCase()}${text.slice(1)}.`;
}

/** Without TLS a page has no clipboard; the ID can be selected by hand. */
function copy(text) {
  const button = h("button", { type: "button", class: "small", "aria-label": "Copy job ID" }, "Copy");
  button.addEventListener("click", () =>
    navigator.clipboard.writeText(text).then(() => { button.textContent = "Copied"; }, () => { button.textContent = "Not copied"; }));
  return button;
}
