// Chooses the jobs to compare a job with.

import { api, h, when } from "../lib/dom.js";
import { MOST_COMPARED, comparisonOf } from "../lib/place.js";
import { presetOf } from "../lib/state.js";

/** Number of newest jobs offered. */
const OFFERED = 50;

/**
 * Asks for jobs, those of the same capture first, and opens the comparison.
 * @param {import("fled-api").Job} job
 */
export async function compareWith(job) {
  /** @type {import("fled-api").Jobs[]} */
  const [same, newest] = await Promise.all([
    api(`v1/jobs?limit=${OFFERED}&capture_id=${job.capture_id}`),
    api(`v1/jobs?limit=${OFFERED}`),
  ]);
  const own = same.jobs.filter((one) => one.id !== job.id);
  const others = newest.jobs.filter((one) => one.capture_id !== job.capture_id);
  const go = h("button", { type: "submit", class: "main", disabled: true }, "Compare");
  const words = h("p", { class: "hint", role: "status" });
  const boxes = [];
  const dialog = h("dialog", { "aria-label": "Compare with" });

  function group(title, jobs) {
    if (jobs.length === 0) return null;
    return h(
      "fieldset",
      {},
      h("legend", {}, title),
      jobs.map((one) => {
        const box = h("input", { type: "checkbox", value: one.id, onchange: count });
        boxes.push(box);
        return h(
          "label",
          { class: "check" },
          box,
          h(
            "span",
            {},
            one.name || "unnamed",
            h(
              "span",
              { class: "soft" },
              ` · ${one.state} · ${presetOf(one)} · ${when(one.created_at)}`,
            ),
          ),
        );
      }),
    );
  }
  const chosen = () => boxes.filter((box) => box.checked).map((box) => box.value);
  function count() {
    const number = chosen().length;
    go.disabled = number === 0 || number >= MOST_COMPARED;
    words.textContent =
      number >= MOST_COMPARED ? `You can compare up to ${MOST_COMPARED} jobs, including this one.` : "";
  }
  const away = () => dialog.close();
  const groups = [
    group("Same photographs", own),
    group("Other photographs, newest first", others),
  ].filter(Boolean);
  dialog.append(
    h("h2", {}, "Compare with"),
    h(
      "form",
      {
        method: "dialog",
        onsubmit: () => {
          location.hash = comparisonOf([job.id, ...chosen()]);
        },
      },
      groups.length > 0
        ? h("div", { class: "choices" }, groups)
        : h("p", {}, "There are no other jobs yet. Run this one again with other options first."),
      words,
      h(
        "div",
        { class: "row" },
        h("button", { type: "button", onclick: away }, "Close"),
        groups.length > 0 && go,
      ),
    ),
  );
  dialog.addEventListener("close", () => {
    removeEventListener("hashchange", away);
    dialog.remove();
  });
  addEventListener("hashchange", away);
  document.body.append(dialog);
  dialog.showModal();
}
