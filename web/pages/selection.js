// Selected jobs of a list, and the actions on all of them.

import { ask } from "../lib/dialog.js";
import { api, count, h } from "../lib/dom.js";
import { edit } from "../lib/edit.js";
import { MOST_COMPARED, comparisonOf } from "../lib/place.js";

const GONE = "This permanently deletes their scenes, pictures and scores. The photographs are kept.";

const nameOf = (job) => `“${job.name || "unnamed"}”`;

/**
 * `{ root, box(job), update(jobs) }`: a bar shown while a job is selected, and a job's check box.
 * `refresh` asks the server again after jobs were deleted.
 */
export function selection(refresh) {
  const chosen = new Map();
  const words = h("span", { role: "status" });
  const compare = h("a", { class: "button main" });
  const change = h("button", { type: "button", onclick: editIt }, "Edit");
  const remove = h("button", { type: "button", class: "danger", onclick: removeAll });
  const none = h("button", { type: "button", onclick: clear }, "Clear selection");
  const problem = h("p", { class: "problem", role: "alert" });
  const root = h(
    "div",
    { class: "marked", hidden: true, role: "region", "aria-label": "Selected jobs" },
    h("div", { class: "row" }, words, compare, change, remove, none),
    problem,
  );
  let shown = [];

  function draw() {
    const jobs = [...chosen.values()];
    root.hidden = jobs.length === 0 && problem.textContent === "";
    const unseen = jobs.filter((job) => !shown.includes(job.id)).length;
    words.textContent = `${howMany(jobs.length)}${whereAre(unseen, jobs.length)}`;
    compare.hidden = jobs.length < 2 || jobs.length > MOST_COMPARED;
    compare.href = comparisonOf([...chosen.keys()]);
    compare.textContent = `Compare ${count(jobs.length, "job")}`;
    change.hidden = jobs.length !== 1;
    remove.hidden = jobs.length === 0;
    none.hidden = jobs.length === 0;
    remove.textContent = `Delete ${count(jobs.length, "job")}`;
  }

  function clear() {
    chosen.clear();
    problem.textContent = "";
    for (const box of root.parentNode.querySelectorAll("input.mark")) box.checked = false;
    draw();
  }

  async function editIt() {
    const [job] = chosen.values();
    if (await edit(job)) await refresh();
  }

  async function removeAll() {
    const jobs = [...chosen.values()];
    const [running, rest] = [
      jobs.filter((job) => job.state === "running"),
      jobs.filter((job) => job.state !== "running"),
    ];
    const [are, them] = running.length === 1 ? ["is", "it"] : ["are", "them"];
    const runs =
      running.length > 0
        ? `\n${running.map(nameOf).join(", ")} ${are} running and will be kept. Cancel ${them} first.`
        : "";
    if (rest.length === 0) {
      problem.textContent = runs.trim();
      return;
    }
    const sure = await ask(
      `Delete ${count(rest.length, "job")}?`,
      `${rest.map(nameOf).join("\n")}\n${GONE}${runs}`,
      `Delete ${count(rest.length, "job")}`,
    );
    if (!sure) return;
    remove.disabled = true;
    const faults = [];
    for (const job of rest) {
      try {
        await api(`v1/jobs/${job.id}`, { method: "DELETE" });
        chosen.delete(job.id);
      } catch (error) {
        // Already deleted elsewhere, as requested.
        if (error.status === 404) chosen.delete(job.id);
        else faults.push(`Could not delete ${nameOf(job)}: ${error.message}`);
      }
    }
    problem.textContent = faults.join("\n");
    remove.disabled = false;
    await refresh();
    draw();
  }

  return {
    root,
    box(job) {
      const box = h("input", {
        type: "checkbox",
        class: "mark",
        checked: chosen.has(job.id),
        "data-key": `mark ${job.id}`,
        "aria-label": `Select ${job.name || "unnamed"}`,
      });
      box.addEventListener("change", () => {
        if (box.checked) chosen.set(job.id, job);
        else chosen.delete(job.id);
        problem.textContent = "";
        draw();
      });
      return box;
    },
    /** Takes the jobs now in the list. */
    update(jobs) {
      shown = jobs.map((job) => job.id);
      for (const job of jobs) if (chosen.has(job.id)) chosen.set(job.id, job);
      draw();
    },
  };
}

function howMany(number) {
  if (number === 0) return "";
  if (number === 1) return "1 job selected. Select another one to compare.";
  return number > MOST_COMPARED
    ? `${number} jobs selected. You can compare up to ${MOST_COMPARED}.`
    : `${number} jobs selected.`;
}

/** A note on selected jobs that a filter hides. */
function whereAre(unseen, number) {
  if (unseen === 0) return "";
  if (unseen === number) return " None of them is shown in the list.";
  return ` ${unseen} of them ${unseen === 1 ? "is" : "are"} not shown in the list.`;
}
