// One capture: its photographs, its jobs, and the form that runs it again.

import { ask } from "../lib/dialog.js";
import { api, count, h, nothing, section, send, show, when } from "../lib/dom.js";
import { jobTable } from "./jobs.js";
import { optionsForm } from "../upload/options.js";
import { positions } from "../job/poses.js";
import { captureWarnings, photographs, used } from "../lib/photographs.js";

const REFRESH_MS = 3000;

/** `from`: a job whose options fill the form. */
export function capturePage(main, id, from) {
  const base = `v1/captures/${id}`;
  const head = h("section", { hidden: true });
  const problem = h("p", { class: "problem", role: "alert" });
  const jobs = jobTable(() => refresh());
  const jobsPart = section("Jobs");
  const warnings = section("Warnings");
  const pictures = section("Photographs");
  let [gone, timer, of] = [false, 0, []];
  /** The job that gave the photographs' positions. */
  let placedBy = null;
  /** @type {import("fled-api").Capture} */
  let shown;

  async function open() {
    try {
      /** @type {import("fled-api").Capture} */
      const capture = await api(base);
      if (gone) return;
      const again = againForm(capture);
      main.append(head, jobsPart, again.root, warnings, pictures);
      document.title = `${capture.name || "Capture"} · fled`;
      const remove = h("button", { type: "button", class: "danger" }, "Delete");
      remove.addEventListener("click", () => removeIt(capture, remove));
      head.append(h("div", { class: "row" }, h("h1", {}, capture.name || "unnamed"),
        h("span", { class: "soft" }, used(capture)), h("span", { class: "row push" }, remove)), problem,
      h("p", { class: "hint" }, `Uploaded ${when(capture.created_at)}${capture.expires_at ? ` · will be deleted on ${when(capture.expires_at)}` : ""}`));
      head.hidden = false;
      show(warnings, captureWarnings(capture));
      shown = capture;
      show(pictures, photographs(capture));
      if (from) await again.begin(from);
      await refresh();
    } catch (error) {
      if (gone) return;
      if (error.status === 404) nothing(main, "Capture not found.", "#/captures", "All captures");
      else { main.append(head); head.hidden = false; head.append(problem); problem.textContent = error.message; }
    }
  }

  async function refresh() {
    clearTimeout(timer);
    try {
      /** @type {import("fled-api").Jobs} */
      const page = await api(`v1/jobs?limit=200&capture_id=${id}`);
      if (gone) return;
      of = page.jobs;
      jobs.update(of);
      showPositions(of.find((job) => job.state === "succeeded"));
      // Showing it again would lose the focus.
      if (jobsPart.hidden === (of.length > 0)) show(jobsPart, of.length > 0 && jobs.root);
    } catch { /* The health line says so; the next round may succeed. */ }
    if (!gone) timer = setTimeout(refresh, REFRESH_MS);
  }

  /** Shows the photographs' positions from the newest finished job. */
  async function showPositions(job) {
    if (!job || job.id === placedBy) return;
    placedBy = job.id;
    const report = await api(`v1/jobs/${job.id}/rounds`).catch(() => null);
    if (report && !gone) show(pictures, photographs(shown, positions(report)));
  }

  async function removeIt(capture, button) {
    problem.textContent = "";
    const uses = of.length > 0 ? ` ${count(of.length, "job")} ${of.length === 1 ? "uses" : "use"} this capture; delete ${of.length === 1 ? "it" : "them"} first.` : "";
    const sure = await ask(`Delete capture “${capture.name || "unnamed"}”?`,
      `This permanently deletes ${count(capture.images.length, "photograph")}.${uses}`, "Delete capture");
    if (!sure) return;
    button.disabled = true;
    try {
      await api(base, { method: "DELETE" });
      location.hash = "#/captures";
    } catch (error) {
      problem.textContent = error.message;
    }
    button.disabled = false;
  }

  open();
  return () => { gone = true; clearTimeout(timer); jobs.leave(); };
}

/**
 * A form that starts another job of the same photographs.
 * @param {import("fled-api").Capture} capture
 */
function againForm(capture) {
  const options = optionsForm();
  const name = h("input", { type: "text", placeholder: capture.name || "Optional", maxLength: 200 });
  const button = h("button", { class: "main", type: "submit" }, "Run");
  const problem = h("p", { class: "problem", role: "alert" });

  async function submit(event) {
    event.preventDefault();
    problem.textContent = "";
    if (!options.check()) return;
    button.disabled = true;
    try {
      const body = { capture_id: capture.id, preset: options.preset.value, options: options.chosen() };
      if (name.value) body.name = name.value;
      /** @type {import("fled-api").Job} */
      const job = await send("v1/jobs", body);
      location.hash = `#/jobs/${job.id}`;
    } catch (error) {
      if (!options.fault(error)) problem.textContent = error.message;
    }
    button.disabled = false;
  }
  const form = h("form", { onsubmit: submit, noValidate: true },
    h("label", {}, "Name", name), h("label", {}, "Preset", options.preset), button, problem, options.root);
  const root = h("section", {}, h("h2", {}, "Run again with other options"), form);
  options.root.open = true;

  return {
    root,
    /** Fills in the options of an existing job. */
    async begin(id) {
      try {
        /** @type {import("fled-api").Job} */
        const job = await api(`v1/jobs/${id}`);
        name.value = job.name;
        await options.fill(job.preset, job.options);
        root.scrollIntoView();
        options.preset.focus({ preventScroll: true });
      } catch (error) {
        problem.textContent = error.message;
      }
    },
  };
}
