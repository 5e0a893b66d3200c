// The form that uploads photographs and starts a job.

import { Refusal, count, h, size } from "./dom.js";
import { takeDrops } from "./dropped.js";
import { optionsForm } from "./options.js";

/** Rejected files that a refused upload names. */
const NAMED = 8;

/** `{ root, leave }`. */
export function startForm() {
  const files = h("input", { type: "file", multiple: true, accept: "image/*,.zip,.tif,.tiff" });
  const folder = h("input", { type: "file", webkitdirectory: true });
  const name = h("input", { type: "text", placeholder: "optional", maxLength: 200 });
  const button = h("button", { class: "main", type: "submit" }, "Start");
  const status = h("p", { class: "hint", role: "status" });
  const problem = h("p", { class: "problem", role: "alert" });
  const options = optionsForm();
  const chosen = chosenFiles();
  const drop = h("div", { class: "drop" },
    h("label", {}, "Photographs, or one zip", files),
    h("label", {}, "or a folder (ground truth in gt/ is taken along)", folder),
    h("p", { class: "hint" }, "or drop them anywhere on this page"));
  for (const input of [files, folder]) {
    input.addEventListener("change", () => {
      chosen.add([...input.files].map((file) => [file.webkitRelativePath || file.name, file]));
      // The list below holds them now, and what was taken out can be chosen again.
      input.value = "";
    });
  }
  const leave = takeDrops(drop, (dropped) => { problem.textContent = ""; chosen.add(dropped); });

  async function submit(event) {
    event.preventDefault();
    problem.textContent = "";
    if (chosen.files().length === 0) { problem.textContent = "Choose photographs, a zip or a folder first."; return; }
    button.disabled = true;
    try {
      const changed = options.chosen();
      const fields = { name: name.value, preset: options.preset.value };
      if (Object.keys(changed).length > 0) fields.options = JSON.stringify(changed);
      const job = await upload(chosen.files(), fields, status);
      location.hash = `#/jobs/${job.id}`;
    } catch (error) {
      if (!options.fault(error)) problem.textContent = error.message;
      status.textContent = "";
    }
    button.disabled = false;
  }
  const form = h("form", { onsubmit: submit, noValidate: true }, drop,
    h("label", {}, "Name", name), h("label", {}, "Preset", options.preset), button, chosen.root, options.root);
  return { root: h("section", {}, h("h2", {}, "New job"), form, status, problem), leave };
}

/** What will be sent, by path; each can be taken out again. */
function chosenFiles() {
  const held = new Map();
  const words = h("span", { role: "status" });
  const list = h("ul", { class: "files", tabIndex: 0, "aria-label": "chosen files" });
  const all = h("button", { type: "button", onclick: () => { held.clear(); draw(); } }, "Take all out");
  const root = h("div", { class: "picked", hidden: true }, h("div", { class: "row" }, words, all), list);

  function draw() {
    const bytes = [...held.values()].reduce((sum, file) => sum + file.size, 0);
    words.textContent = held.size === 0 ? "" : `${count(held.size, "file")} chosen, ${size(bytes)}`;
    root.hidden = held.size === 0;
    list.replaceChildren(...[...held].map(([path, file]) => h("li", {},
      h("span", { class: "path" }, path), h("span", { class: "soft" }, size(file.size)),
      h("button", { type: "button", "aria-label": `Take out ${path}`, onclick: () => takeOut(path) }, "Take out"))));
  }

  function takeOut(path) {
    const at = [...held.keys()].indexOf(path);
    held.delete(path);
    draw();
    // Whoever takes out several by keyboard goes on where they were.
    const buttons = list.querySelectorAll("button");
    buttons[Math.min(at, buttons.length - 1)]?.focus();
  }

  return {
    root,
    files: () => [...held],
    add(files) {
      // Hidden files are what systems leave in folders.
      for (const [path, file] of files) if (!path.split("/").some((part) => part.startsWith("."))) held.set(path, file);
      draw();
    },
  };
}

/** Sends capture and job in one request, with progress. fetch() cannot tell upload progress yet. */
function upload(files, fields, status) {
  const body = new FormData();
  for (const [key, value] of Object.entries(fields)) if (value) body.append(key, value);
  for (const [path, file] of files) body.append("images", file, path);
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
      if (request.status === 202) resolve(request.response);
      else reject(withRejected(new Refusal(request.status, request.response)));
    };
    request.onerror = () => reject(new Error("The server does not answer."));
    request.send(body);
  });
}

function withRejected(error) {
  const rejected = (error.capture?.images ?? []).filter((image) => !image.accepted);
  const lines = rejected.slice(0, NAMED).map((image) => `${image.name}: ${image.reason ?? "rejected"}`);
  if (rejected.length > NAMED) lines.push(`and ${rejected.length - NAMED} more`);
  error.message = [error.message, ...lines].join("\n");
  return error;
}
