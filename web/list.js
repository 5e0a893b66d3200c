// The list of jobs and the form that starts one.

import { api, doing, duration, h, pill } from "./dom.js";

const REFRESH_MS = 1500;

export function listPage(main) {
  const rows = h("tbody");
  const table = h("table", {},
    h("thead", {}, h("tr", {}, ...["Name", "State", "Progress"].map((t) => h("th", {}, t)),
      h("th", { class: "wide" }, "Now"), h("th", { class: "wide" }, "Left"), h("th", { class: "wide" }, "Preset"), h("th", { class: "wide" }, "Created"))),
    rows);
  const empty = h("p", { class: "hint" }, "No job yet. Start with a folder of 20 to 60 overlapping photographs of a place in which nothing moves.");
  const more = h("button", { type: "button", hidden: true }, "Older jobs");
  main.append(startForm(), h("section", {}, h("h2", {}, "Jobs"), table, empty, more));
  let limit = 50;
  let timer = 0;
  let gone = false;
  more.addEventListener("click", () => { limit = Math.min(limit + 50, 200); refresh(); });

  async function refresh() {
    clearTimeout(timer);
    try {
      const { jobs, next_cursor } = await api(`/v1/jobs?limit=${limit}`);
      if (gone) return;
      rows.replaceChildren(...jobs.map(row));
      empty.hidden = jobs.length > 0;
      table.hidden = jobs.length === 0;
      more.hidden = !next_cursor || limit >= 200;
    } catch { /* The health line says so; the next round may succeed. */ }
    if (!gone) timer = setTimeout(refresh, REFRESH_MS);
  }
  refresh();
  return () => { gone = true; clearTimeout(timer); };
}

function row(job) {
  return h("tr", {},
    h("td", {}, h("a", { href: `#/jobs/${job.id}` }, job.name || "unnamed")),
    h("td", {}, pill(job)),
    h("td", {}, h("progress", { max: 1, value: job.progress, "aria-label": "progress" })),
    h("td", { class: "wide" }, doing(job) || (job.error ? job.error.code.replaceAll("_", " ") : "")),
    h("td", { class: "wide" }, job.state === "running" ? duration(job.eta_seconds) : ""),
    h("td", { class: "wide" }, job.preset),
    h("td", { class: "wide soft" }, new Date(job.created_at).toLocaleString()));
}

function startForm() {
  const files = h("input", { type: "file", multiple: true, accept: "image/*,.zip,.tif,.tiff" });
  const folder = h("input", { type: "file", webkitdirectory: true });
  const name = h("input", { type: "text", placeholder: "optional", maxLength: 200 });
  const preset = h("select", {},
    h("option", { value: "preview" }, "preview: a quick look"),
    h("option", { value: "standard", selected: true }, "standard"),
    h("option", { value: "paper" }, "paper: a GPU's work"));
  const button = h("button", { class: "main", type: "submit" }, "Start");
  const status = h("p", { class: "hint", role: "status" });
  const problem = h("p", { class: "problem", role: "alert" });
  const drop = h("div", { class: "drop" },
    h("label", {}, "Photographs, or one zip", files),
    h("label", {}, "or a folder (ground truth in gt/ is taken along)", folder));
  let dropped = [];
  drop.addEventListener("dragover", (event) => { event.preventDefault(); drop.classList.add("over"); });
  drop.addEventListener("dragleave", () => drop.classList.remove("over"));
  drop.addEventListener("drop", (event) => {
    event.preventDefault();
    drop.classList.remove("over");
    dropped = [...event.dataTransfer.files];
    status.textContent = `${dropped.length} files dropped`;
  });
  const form = h("form", {
    onsubmit: async (event) => {
      event.preventDefault();
      problem.textContent = "";
      const chosen = [...files.files, ...folder.files, ...dropped];
      if (chosen.length === 0) { problem.textContent = "Choose photographs, a zip or a folder first."; return; }
      button.disabled = true;
      try {
        const job = await upload(chosen, { name: name.value, preset: preset.value }, status);
        location.hash = `#/jobs/${job.id}`;
      } catch (error) {
        problem.textContent = error.message;
        status.textContent = "";
      }
      button.disabled = false;
    },
  }, drop, h("label", {}, "Name", name), h("label", {}, "Preset", preset), button);
  return h("section", {}, h("h2", {}, "New job"), form, status, problem);
}

/** Sends capture and job in one request, with progress. fetch() cannot tell upload progress yet. */
function upload(files, fields, status) {
  const body = new FormData();
  for (const [key, value] of Object.entries(fields)) if (value) body.append(key, value);
  for (const file of files) {
    const path = file.webkitRelativePath || file.name;
    if (!path.split("/").some((part) => part.startsWith("."))) body.append("images", file, path);
  }
  const request = new XMLHttpRequest();
  request.open("POST", "/v1/jobs");
  // A double click or a repeated request must not start two jobs.
  request.setRequestHeader("Idempotency-Key", crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}`);
  request.responseType = "json";
  request.upload.onprogress = (event) => {
    const done = event.loaded / event.total;
    status.textContent = done < 1 ? `Sending: ${Math.round(100 * done)} %` : "Looking at the photographs ...";
  };
  return new Promise((resolve, reject) => {
    request.onload = () => {
      const answer = request.response ?? {};
      if (request.status === 202) { resolve(answer); return; }
      const rejected = (answer.capture?.images ?? []).filter((image) => !image.accepted);
      const lines = rejected.slice(0, 8).map((image) => `${image.name}: ${image.reason ?? "rejected"}`);
      reject(new Error([answer.detail ?? `The server answered ${request.status}.`, answer.hint, ...lines].filter(Boolean).join("\n")));
    };
    request.onerror = () => reject(new Error("The server does not answer."));
    request.send(body);
  });
}
