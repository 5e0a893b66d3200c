// The form that uploads photographs and starts a job.

import { begun } from "./begun.js";
import { earlier } from "./earlier.js";
import { Refusal, api, count, duration, h, send, size } from "../lib/dom.js";
import { takeDrops } from "./dropped.js";
import { leftovers } from "./leftover.js";
import { looked } from "./looked.js";
import { optionsForm } from "./options.js";
import { sending } from "./sending.js";
import { seconds } from "../lib/state.js";

/** Rejected files that a refused upload names. */
const NAMED = 8;
/** Number of finished jobs used to estimate the next one's time. */
const RECENT = 5;
/** The name of the server's sample. */
const SAMPLE = "Sample: a dark room";
/** Seconds before a rate is shown. */
const RATE_AFTER = 2;

/** `{ root, leave, known(jobs) }`: the form shows how long such jobs took recently. */
export function startForm() {
  // The list below shows the chosen files; the browser's own text would claim there are none.
  const files = h("input", { type: "file", class: "heard", multiple: true, accept: "image/*,.zip,.jfif,.mpo,.tif,.tiff,.heic,.heif,.hif,.3fr,.arw,.cr2,.cr3,.crw,.dcr,.dng,.erf,.fff,.gpr,.iiq,.kdc,.mef,.mos,.mrw,.nef,.nrw,.orf,.pef,.raf,.rw2,.rwl,.sr2,.srf,.srw,.x3f,.mp4,.mov,.m4v" });
  const folder = h("input", { type: "file", class: "heard", webkitdirectory: true });
  const name = h("input", { type: "text", placeholder: "Optional", maxLength: 200 });
  const button = h("button", { class: "main", type: "submit" }, "Start");
  const status = h("span", { class: "hint", role: "status" });
  const usual = h("p", { class: "hint" });
  const cancel = h("button", { type: "button", hidden: true, onclick: () => { isCancelled = true; run?.stop(); } }, "Cancel");
  const problem = h("p", { class: "problem", role: "alert" });
  const options = optionsForm();
  const chosen = chosenFiles();
  const trial = h("button", { type: "button", onclick: sample }, "Try a sample");
  const drop = h("div", { class: "drop" },
    h("p", {}, "Drop photographs, a folder, a ZIP file or a video anywhere on this page, or"),
    h("div", { class: "row" }, h("label", { class: "button" }, "Choose files", files), h("label", { class: "button" }, "Choose a folder", folder),
      trial),
    h("p", { class: "hint" }, "fled uses the 40 sharpest frames of a video. A folder may contain ground truth in gt/."));
  for (const input of [files, folder]) {
    input.addEventListener("change", () => {
      add([...input.files].map((file) => [file.webkitRelativePath || file.name, file]));
      // The list below holds the files now; a file removed there can be chosen again.
      input.value = "";
    });
  }
  const left = h("div", {}, leftovers());
  const before = earlier();
  drop.append(before.root, left);
  let [run, gone, isCancelled] = [null, false, false];
  const leaveDrops = takeDrops(drop, add);

  function add(files) {
    problem.textContent = chosen.add(files) || before.fault(chosen.files());
  }

  async function submit(event) {
    event.preventDefault();
    problem.textContent = "";
    const isEmpty = chosen.files().length === 0;
    if (isEmpty) problem.textContent = "Choose photographs, a ZIP file, a video or a folder first.";
    else problem.textContent = before.fault(chosen.files());
    // All errors are shown at once.
    if (!options.check() || problem.textContent) return;
    button.disabled = true;
    isCancelled = false;
    // These may be the uploads that are being sent.
    left.replaceChildren();
    try {
      const changed = options.chosen();
      const fields = { preset: options.preset.value, options: changed };
      if (name.value) fields.name = name.value;
      if (before.id()) fields.add_to = before.id();
      const sent = upload(chosen.files(), fields, (line, isSending) => {
        status.textContent = line;
        cancel.hidden = !isSending;
      });
      run = sent.run;
      const job = await sent.job;
      if (!gone) location.hash = `#/jobs/${job.id}`;
    } catch (error) {
      if (gone) return;
      left.replaceChildren(...leftovers());
      status.textContent = isCancelled ? "Upload cancelled. Start continues where it stopped." : "";
      if (!isCancelled && !options.fault(error)) problem.textContent = error.message;
    }
    run = null;
    cancel.hidden = true;
    button.disabled = false;
  }

  /** Opens the finished job of the server's sample, or starts one with other options. */
  async function sample() {
    problem.textContent = "";
    if (!options.check()) return;
    const ready = finished.find((job) => job.name === SAMPLE && options.asFor(job));
    if (ready) {
      location.hash = `#/jobs/${ready.id}`;
      return;
    }
    trial.disabled = true;
    status.textContent = "Preparing the sample…";
    try {
      let job = finished.find(({ warnings }) => warnings.some(({ code }) => code === "recorded"));
      if (!job) {
        /** @type {import("fled-api").Capture} */
        const capture = await api("v1/captures/sample", { method: "POST" });
        /** @type {import("fled-api").Jobs} */
        const { jobs } = await api(`v1/jobs?capture_id=${capture.id}`);
        [job] = jobs;
      }
      if (!options.asFor(job)) {
        job = await send("v1/jobs", { capture_id: job.capture_id, preset: options.preset.value, options: options.chosen() });
      }
      if (!gone) location.hash = `#/jobs/${job.id}`;
    } catch (error) {
      if (!gone && !options.fault(error)) problem.textContent = error.message;
    }
    status.textContent = "";
    trial.disabled = false;
  }

  /** The server keeps its pieces; the upload resumes when the same files are chosen. */
  function leave() {
    gone = true;
    run?.stop();
    leaveDrops();
  }
  const form = h("form", { onsubmit: submit, noValidate: true }, drop, chosen.root,
    h("label", {}, "Name", name), h("label", {}, "Preset", options.preset), h("div", { class: "row" }, button, cancel, status), usual, problem, options.root);

  let finished = [];
  function tellTimes() {
    // A recorded one took no time here.
    const times = finished.filter((job) => job.preset === options.preset.value && seconds(job) > 0).slice(0, RECENT).map(seconds).sort((a, b) => a - b);
    const [least, most] = [times[0], times.at(-1)].map(duration);
    usual.textContent = times.length === 0 ? "" : `Recent ${options.preset.value} jobs took ${least === most ? least : `${least} to ${most}`}.`;
  }
  options.preset.addEventListener("change", tellTimes);
  return {
    root: h("section", {}, h("h2", {}, "New job"), form),
    leave,
    /** Takes the server's jobs, newest first. */
    known(jobs) {
      finished = jobs.filter((job) => job.state === "succeeded");
      tellTimes();
    },
  };
}

/** The files to send, by path; each can be removed. */
function chosenFiles() {
  const held = new Map();
  const words = h("span", { role: "status" });
  const list = h("ul", { class: "files", tabIndex: 0, "aria-label": "Chosen files" });
  const all = h("button", { type: "button", onclick: () => { held.clear(); draw(); } }, "Remove all");
  const root = h("div", { class: "picked", hidden: true }, h("div", { class: "row" }, words, all), list);

  /** Rows are kept, so that their pictures are made once. */
  const rows = new Map();
  function line(path, file) {
    const { picture, fault } = looked(path, file);
    return h("li", {}, picture, h("span", { class: "of" }, h("span", { class: "path" }, path), " ", fault), h("span", { class: "soft" }, size(file.size)),
      h("button", { type: "button", "aria-label": `Remove ${path}`, onclick: () => removeOne(path) }, "Remove"));
  }

  function draw() {
    const bytes = [...held.values()].reduce((sum, file) => sum + file.size, 0);
    words.textContent = held.size === 0 ? "" : `${count(held.size, "file")} chosen, ${size(bytes)}`;
    root.hidden = held.size === 0;
    for (const path of rows.keys()) if (!held.has(path)) rows.delete(path);
    for (const [path, file] of held) if (!rows.has(path)) rows.set(path, line(path, file));
    list.replaceChildren(...[...held.keys()].map((path) => rows.get(path)));
  }

  function removeOne(path) {
    const at = [...held.keys()].indexOf(path);
    held.delete(path);
    draw();
    // Focuses the next button, for keyboard users.
    const buttons = list.querySelectorAll("button");
    buttons[Math.min(at, buttons.length - 1)]?.focus();
  }

  return {
    root,
    files: () => [...held],
    /**
     * Returns the problem, if any: of two files of one name only the first is kept, as poses could
     * not distinguish them.
     */
    add(files) {
      const other = (a, b) => a && (a.size !== b.size || a.lastModified !== b.lastModified);
      const twice = [];
      for (const [path, file] of files) {
        // Hidden files are left by operating systems.
        if (path.split("/").some((part) => part.startsWith("."))) continue;
        if (other(held.get(path), file)) twice.push(path);
        else held.set(path, file);
      }
      draw();
      return twice.length === 0 ? ""
        : `Two different files are called ${twice[0]}; the first is kept. Remove it first, or choose a folder that contains both.`;
    },
  };
}

/** Sends the files, then requests their job; reports progress to `show(line, isSending)`. */
function upload(files, fields, show) {
  const began = performance.now();
  let before = null;
  const run = sending(files, ({ sent, total, files: done, waits }) => {
    before ??= sent;
    const share = total > 0 ? Math.floor((100 * sent) / total) : 100;
    const seconds = (performance.now() - began) / 1000;
    const rate = seconds > RATE_AFTER ? ` · ${size(Math.round((sent - before) / seconds))}/s` : "";
    show(waits ? `${waits} at ${share} %. Retrying…`
      : `Uploading: ${share} %, ${done} of ${count(files.length, "file")}${rate}`, true);
  });
  // A double click or a repeated request must not start two jobs.
  const key = crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}`;
  async function job() {
    const uploads = await run.done;
    show("Checking the photographs…", false);
    try {
      const made = await again(() => api("v1/jobs", {
        method: "POST",
        headers: { "Content-Type": "application/json", "Idempotency-Key": key },
        body: JSON.stringify({ uploads, ...fields }),
      }));
      begun.forget(files);
      return made;
    } catch (error) {
      // Uploads that the server has lost are sent again the next time.
      if (error.status === 404) begun.forget(files);
      // Otherwise they are complete: it is no interrupted upload.
      else if (error.capture) begun.refuse(files);
      throw withRejected(error);
    }
  }
  return { job: job(), run };
}

/** Repeats a request while the server does not answer; the key makes it a single one. */
async function again(ask) {
  for (const seconds of [1, 2, 5, 10]) {
    try {
      return await ask();
    } catch (error) {
      if (error instanceof Refusal) throw error;
      await new Promise((resolve) => { setTimeout(resolve, 1000 * seconds); });
    }
  }
  return ask().catch((error) => { throw error instanceof Refusal ? error : new Error("The server is not responding."); });
}

/** Adds the rejected files that the message does not name. */
function withRejected(error) {
  const rejected = (error.capture?.images ?? []).filter((image) => !image.accepted && !error.message.includes(image.name));
  const lines = rejected.slice(0, NAMED).map((image) => `${image.name}: ${image.reason ?? "rejected"}`);
  if (rejected.length > NAMED) lines.push(`and ${rejected.length - NAMED} more`);
  error.message = [error.message, ...lines].join("\n");
  return error;
}
