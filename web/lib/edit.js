// A dialog for the name and tags of a job.

import { answered } from "./dialog.js";
import { api, h } from "./dom.js";

/**
 * Asks for a job's name and tags and changes them; returns whether they changed.
 * @param {import("fled-api").Job} job
 * @returns {Promise<boolean>}
 */
export function edit(job) {
  const name = h("input", { type: "text", required: true, maxLength: 200, value: job.name });
  const tags = h("input", { type: "text", value: job.tags.join(", "), placeholder: "hall, tripod" });
  const problem = h("p", { class: "problem", role: "alert" });
  const save = h("button", { type: "submit", class: "main" }, "Save");
  const form = h("form", { onsubmit: submit },
    h("label", {}, "Name", name), h("label", {}, "Tags, separated by commas", tags), problem,
    h("div", { class: "row" }, h("button", { type: "button", onclick: () => dialog.close("no") }, "Cancel"), save));
  const dialog = h("dialog", { "aria-label": "Name and tags" }, h("h2", {}, "Name and tags"), form);

  async function submit(event) {
    event.preventDefault();
    save.disabled = true;
    try {
      const words = tags.value.split(",").map((tag) => tag.trim()).filter(Boolean);
      const body = JSON.stringify({ name: name.value, tags: words });
      const headers = { "Content-Type": "application/json" };
      await api(`v1/jobs/${job.id}`, { method: "PATCH", headers, body });
      dialog.close("yes");
    } catch (error) {
      problem.textContent = error.message;
    }
    save.disabled = false;
  }

  return answered(dialog);
}
