// The jobs as cards, each with the picture of its scene and its verdict.

import { api, h, refill } from "../lib/dom.js";
import { now } from "./jobs.js";
import { selection } from "./selection.js";
import { isOver, pill, setBar, tagList, took } from "../lib/state.js";
import { thumbs } from "./thumbs.js";
import { failed } from "../lib/words.js";
import { verdict } from "../job/verdict.js";

/** The same as `jobTable`, as cards. */
export function gallery(refresh) {
  const marked = selection(refresh);
  const verdicts = new Map();
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
    line(job).classList.add(judged.tone);
    line(job).replaceChildren(h("strong", {}, judged.figure), " ", judged.words);
  }

  function card(job, known) {
    const bar = h("progress", { max: 1, "aria-label": "Progress", class: job.state });
    setBar(bar, job);
    const pair = pictures.pairOf(job);
    return h("li", { class: "scene-card" },
      h("div", { class: "pictures" }, pair, peek(job, pair)),
      h("div", { class: "row" }, h("a", { href: `#/jobs/${job.id}` }, job.name || "unnamed"), job.state !== "succeeded" && pill(job), tagList(job)),
      job.state === "succeeded" ? line(job) : h("p", { class: job.error ? "bad" : "soft" }, job.error ? failed(job.error) : now(job, known)),
      !isOver(job) && bar,
      h("p", { class: "row soft" }, [job.preset, took(job)].filter(Boolean).join(" · "), h("span", { class: "push" }, marked.box(job))));
  }

  return {
    root,
    update(jobs, known = jobs) {
      const state = JSON.stringify([jobs, known.map((job) => job.queue_position)]);
      if (state === shown) return;
      shown = state;
      root.hidden = false;
      refill(list, jobs.map((job) => card(job, known)));
      marked.update(jobs);
    },
    leave: () => pictures.leave(),
  };
}

/** Shows the photograph where there is no pointer to hover with. */
function peek(job, pair) {
  const button = h("button", { type: "button", class: "peek small", "aria-pressed": "false", "data-key": `peek ${job.id}`, "aria-label": `Photograph of ${job.name || "unnamed"}` }, "Photograph");
  button.addEventListener("click", () => {
    const isOn = pair.classList.toggle("dark");
    button.setAttribute("aria-pressed", String(isOn));
  });
  return button;
}
