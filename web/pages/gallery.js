// The jobs as cards, each with the picture of its scene and its verdict.

import { api, h, refill } from "../lib/dom.js";
import { now } from "./jobs.js";
import { selection } from "./selection.js";
import { isOver, pill, presetOf, setBar, tagList, took } from "../lib/state.js";
import { thumbs } from "./thumbs.js";
import { failed } from "../lib/words.js";
import { verdict } from "../job/verdict.js";

/** The same as `jobTable`, as cards. */
export function gallery(refresh) {
  const marked = selection(refresh);
  const verdicts = new Map();
  const cards = new Map();
  const pictures = thumbs((job) => judge(job));
  const list = h("ul", { class: "gallery bare" });
  const root = h("div", { hidden: true }, list, marked.root);
  let shown = "";

  /** The line for a job's verdict, kept between redraws and filled in when its card comes near. */
  function line(job) {
    if (!verdicts.has(job.id)) verdicts.set(job.id, h("p", { class: "judged" }));
    return verdicts.get(job.id);
  }

  async function judge(job) {
    const report = job.state === "succeeded" && (await api(`v1/jobs/${job.id}/rounds`).catch(() => null));
    const judged = report && verdict(report);
    if (!judged) return;
    line(job).className = `judged ${judged.tone}`;
    line(job).replaceChildren(h("strong", {}, judged.figure), " ", judged.words);
  }

  /** The card of a job; one that says the same as before is left alone, as redrawing flickers. */
  function card(job, known) {
    const doing = now(job, known);
    const said = JSON.stringify([job, doing]);
    const kept = cards.get(job.id) ?? { root: h("li", { class: "scene-card" }), said: "" };
    cards.set(job.id, kept);
    if (kept.said === said) return kept.root;
    kept.said = said;
    refill(kept.root, content(job, doing).filter(Boolean));
    return kept.root;
  }

  function content(job, doing) {
    const bar = h("progress", { max: 1, "aria-label": "Progress", class: job.state });
    setBar(bar, job);
    const pair = pictures.pairOf(job);
    return [
      h("div", { class: "pictures" }, pair, peek(job, pair)),
      h("div", { class: "row" }, h("a", { href: `#/jobs/${job.id}` }, job.name || "unnamed"), job.state !== "succeeded" && pill(job), tagList(job)),
      job.state === "succeeded" && line(job),
      // A job that waits to retry has both.
      job.error && h("p", { class: "bad" }, failed(job.error)),
      doing && h("p", { class: "soft" }, doing),
      !isOver(job) && bar,
      h("p", { class: "row soft" }, [presetOf(job), took(job)].filter(Boolean).join(" · "), h("span", { class: "push" }, marked.box(job))),
    ];
  }

  return {
    root,
    update(jobs, known = jobs) {
      const state = JSON.stringify([jobs, known.map((job) => job.queue_position)]);
      if (state === shown) return;
      shown = state;
      root.hidden = false;
      const roots = jobs.map((job) => card(job, known));
      const isSame = (one, i) => one === list.children[i];
      if (roots.length !== list.children.length || !roots.every(isSame)) refill(list, roots);
      // A box out of sight is not cleared with the others.
      const ids = new Set(jobs.map(({ id }) => id));
      for (const id of cards.keys()) if (!ids.has(id)) cards.delete(id);
      marked.update(jobs);
    },
    leave: () => pictures.leave(),
  };
}

/** Shows the photograph where there is no pointer to hover with. */
function peek(job, pair) {
  const isDark = String(pair.classList.contains("dark"));
  const button = h("button", { type: "button", class: "peek small", "aria-pressed": isDark, "data-key": `peek ${job.id}`, "aria-label": `Photograph of ${job.name || "unnamed"}` }, "Photograph");
  button.addEventListener("click", () => {
    const isOn = pair.classList.toggle("dark");
    button.setAttribute("aria-pressed", String(isOn));
  });
  return button;
}
