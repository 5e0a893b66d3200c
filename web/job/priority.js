// The priority of a waiting job.

import { h, send } from "../lib/dom.js";
import { seesAll } from "../lib/login.js";

/** Limit in both directions. */
const MOST = 100;

/**
 * The priority field of a waiting job: `{ root, update(job) }`. `changed` is called once the
 * server has accepted a new number.
 */
export function priorityField(base, changed, who) {
  // Above 0 it precedes other users' jobs, which not every token may do.
  const most = seesAll(who) ? MOST : 0;
  const field = h("input", { type: "number", min: -MOST, max: most, step: 1, required: true });
  const problem = h("span", { class: "problem", role: "alert" });
  const root = h("p", { class: "row priority", hidden: true },
    h("label", {}, "Priority", field),
    h("span", { class: "hint" }, "Waiting jobs with a higher priority start first."),
    problem);
  /** The server's number. */
  let known = 0;
  let asks = false;

  field.addEventListener("change", async () => {
    problem.textContent = "";
    if (!field.reportValidity()) return;
    const wanted = field.valueAsNumber;
    asks = true;
    try {
      await send(`${base}/priority`, { priority: wanted }, "PUT");
      known = wanted;
      await changed();
    } catch (fault) {
      problem.textContent = fault.message;
      field.value = String(known);
    }
    asks = false;
  });

  return {
    root,
    /** @param {import("fled-api").Job} job */
    update(job) {
      root.hidden = job.state !== "queued";
      // A number being typed is not final.
      if (asks || (field === document.activeElement && field.value !== String(known))) return;
      known = job.priority;
      if (field.value !== String(known)) field.value = String(known);
    },
  };
}
