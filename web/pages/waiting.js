// Waiting jobs, by the machine they need.

import { count, h, prose, refill } from "../lib/dom.js";

/** Jobs named per group; the list has all. */
const NAMED = 5;

/** The section of waiting jobs: `{ root, update(page, isSeen) }`. */
export function waitingList() {
  const content = h("div");
  const root = h("section", { class: "waiting", hidden: true }, h("h2", {}, "Waiting"), content);
  let shown = "";
  return {
    root,
    /** @param {import("fled-api").Jobs} page */
    update(page, isSeen) {
      root.hidden = !isSeen && page.jobs.length === 0;
      const nodes = drawn(page);
      const now = nodes.map((node) => node.outerHTML).join();
      if (now !== shown) refill(content, nodes);
      shown = now;
    },
  };
}

/** @param {import("fled-api").Jobs} page */
function drawn({ jobs, next_cursor: next }) {
  if (jobs.length === 0) return [h("p", { class: "hint" }, "No jobs are waiting.")];
  const groups = new Map();
  for (const job of jobs.toSorted((a, b) => a.queue_position - b.queue_position)) {
    const wanted = job.waits_for ?? "any worker";
    groups.set(wanted, [...(groups.get(wanted) ?? []), job]);
  }
  const list = h("ul", { class: "bare" }, [...groups].map(group));
  const all = next ? `All waiting jobs (only the ${jobs.length} newest are listed here)` : "All waiting jobs";
  return [list, h("p", {}, h("a", { href: "#/?state=queued" }, all))];
}

/** The number of jobs waiting for the same machine, and the first of them. */
function group([wanted, jobs]) {
  const links = jobs.slice(0, NAMED).flatMap((job, i) => [
    i > 0 && ", ",
    h("a", { href: `#/jobs/${job.id}` }, job.name || "unnamed"),
  ]);
  const rest = jobs.length > NAMED ? ` and ${(jobs.length - NAMED).toLocaleString()} more` : "";
  const lack = jobs.find((job) => job.no_worker)?.no_worker;
  const said = `${count(jobs.length, "job")} waiting for ${wanted}: `;
  return h("li", {}, said, links, rest, lack && h("p", { class: "problem" }, prose(lack)));
}
