// The head of a job's page: its state and the actions on it.

import { compareWith } from "../compare/choose.js";
import { ask } from "../lib/dialog.js";
import { api, h, prose, when } from "../lib/dom.js";
import { edit } from "../lib/edit.js";
import { seesAll } from "../lib/login.js";
import { priorityField } from "./priority.js";
import { failure, isOver, presetOf, progressLine, setBar, stateWord, tagList } from "../lib/state.js";
import { advice } from "../lib/words.js";

const SECOND_MS = 1000;

/** COLMAP's own strategies count a few steps; the matcher counts photographs and their pairs. */
const LEAST_PAIRS = 10;

/**
 * `{ root, update(job), advance(event), begin(), attempt(event), sum(result), leave }`; `refresh` asks the server again
 * after an action. A visitor by a link to the job has no actions.
 */
export function jobHead(base, refresh, who) {
  const isVisitor = who.job !== null;
  const title = h("h1");
  const state = h("span", { class: "state" });
  const line = h("span", { class: "soft now" });
  const keeping = h("p", { class: "row" });
  const priority = priorityField(base, refresh, who);
  const facts = h("p", { class: "hint" });
  const preset = h("span");
  const bar = h("progress", { max: 1, value: 0, "aria-label": "Progress" });
  const needs = h("p", { class: "needs", hidden: true });
  const error = h("p", { class: "problem" });
  const meaning = h("p", { class: "hint advice" });
  const problem = h("p", { class: "problem", role: "alert" });
  const result = h("div");
  const again = h("a", { class: "button" }, "Run again with other options");
  const more = h("a", { class: "button main" }, "Add photographs");
  const tags = h("span", { class: "tags" });
  const change = action("Edit", () => edit(job));
  change.hidden = false;
  const compare = action("Compare with…", () => compareWith(job));
  compare.hidden = false;
  const buttons = {
    cancel: action("Cancel job", () => api(`${base}/cancel`, { method: "POST" }), () =>
      ask("Cancel this job?", "Finished work is kept, and you can try again later.", "Cancel job", "Keep running")),
    retry: action("Try again", () => api(`${base}/retry`, { method: "POST" })),
    remove: action("Delete", removed, (job) =>
      ask(`Delete job “${job.name || "unnamed"}”?`, "This permanently deletes its scene, pictures and scores. The photographs are kept.", "Delete job"), "danger"),
  };
  const actions = h("span", { class: "row push" }, buttons.cancel, more, buttons.retry, change, compare, again, buttons.remove);
  const root = h("section", { hidden: true },
    h("div", { class: "row" }, title, state, tags, line, !isVisitor && actions),
    isVisitor ? "" : keeping, isVisitor ? "" : priority.root, facts, bar, needs, error, meaning, problem, result);
  /** @type {import("fled-api").Job | null} */
  let job = null;
  let gone = false;

  async function removed() {
    await api(base, { method: "DELETE" });
    location.hash = "#/";
  }

  /** A button that asks its question, if any, and then acts. */
  function action(label, act, question, style = "") {
    const button = h("button", { type: "button", class: style, hidden: true }, label);
    button.addEventListener("click", async () => {
      if (question && !(await question(job))) return;
      button.disabled = true;
      problem.textContent = "";
      try {
        await act();
        if (!gone && job && location.hash.includes(job.id)) await refresh();
      } catch (fault) {
        problem.textContent = fault.message;
      }
      button.disabled = false;
    });
    return button;
  }

  /** When the server will delete the job, and how to keep it. */
  let kept = "";
  function showKeeping() {
    const now = `${job.pinned} ${job.expires_at}`;
    if (now === kept) return;
    kept = now;
    const pin = (label, method) => {
      const button = action(label, () => api(`${base}/pin`, { method }));
      button.hidden = false;
      return button;
    };
    keeping.className = `row ${job.pinned ? "hint" : "problem"}`;
    if (job.pinned) keeping.replaceChildren("Kept until you delete it.", pin("Allow deletion", "DELETE"));
    else if (job.expires_at) keeping.replaceChildren(`This job will be deleted on ${when(job.expires_at)}.`, pin("Keep job", "PUT"));
    else keeping.replaceChildren();
  }

  /** A waiting job's requirements of its machine. */
  let needed = "";
  function showNeeds() {
    const now = job.no_worker ?? job.waits_for ?? "";
    if (now === needed) return;
    needed = now;
    needs.hidden = !now;
    if (!now) return;
    needs.replaceChildren(...(job.no_worker ? prose(now) : [`Waiting for ${now}. Jobs that need less may start first.`]));
    if (seesAll(who)) needs.append(" ", h("a", { href: "#/workers" }, "View workers"));
  }

  /** @type {import("../lib/state.js").Search} */
  let search = { matched: null, strategies: [] };
  let heard = Date.now();
  function showLine() {
    if (job) line.textContent = progressLine(job, search, (Date.now() - heard) / 1000);
  }
  const timer = setInterval(showLine, SECOND_MS);

  return {
    root,
    update(now) {
      const first = job === null;
      job = now;
      heard = Date.now();
      title.textContent = job.name || "unnamed";
      tags.replaceChildren(...tagList(job));
      document.title = `${job.name || "Job"} · fled`;
      state.className = `state ${job.state}`;
      state.textContent = stateWord(job);
      showLine();
      buttons.cancel.hidden = isOver(job);
      buttons.retry.hidden = !["failed", "cancelled"].includes(job.state);
      buttons.remove.hidden = job.state === "running";
      again.hidden = !isOver(job);
      const isFew = job.error?.code === "few_poses" && isOver(job);
      more.hidden = !isFew;
      more.href = `#/?add=${job.capture_id}`;
      // The same photographs would fail again.
      if (isFew && actions.lastChild !== buttons.retry) actions.append(buttons.retry);
      again.href = `#/captures/${job.capture_id}/from/${job.id}`;
      preset.textContent = presetOf(job, true);
      showKeeping();
      priority.update(job);
      showNeeds();
      if (first) {
        facts.append(preset, ` · created ${when(job.created_at)}`);
        if (!isVisitor) facts.append(" · ", h("a", { href: `#/captures/${job.capture_id}` }, "View photographs"));
      }
      setBar(bar, job);
      bar.hidden = job.state === "succeeded";
      bar.className = job.state;
      if (!bar.hidden) result.replaceChildren();
      error.textContent = job.error ? failure(job.error) : "";
      meaning.textContent = job.error ? advice(job.error) : "";
      root.hidden = false;
    },
    /** Takes a progress event of the current stage. */
    advance({ stage, done, total }) {
      search.matched = stage === "poses" && total >= LEAST_PAIRS ? { done, total } : null;
      showLine();
    },
    /** Takes the start of a stage. */
    begin() { search = { matched: null, strategies: [] }; },
    /** Takes the start of a strategy of structure from motion. */
    attempt({ name }) {
      search = { matched: null, strategies: [...search.strategies, name] };
      showLine();
    },
    sum(node) { result.replaceChildren(node); },
    leave() { gone = true; clearInterval(timer); },
  };
}
