// Uploads files to the server in resumable pieces: tus 1.0.

import { Refusal } from "../lib/dom.js";
import { begun } from "./begun.js";

const UPLOADS = "v1/uploads";
const TYPE = "application/offset+octet-stream";
/** Bytes per piece, the most that a lost connection costs; a proxy may allow less, down to `LEAST`. */
const PIECE = 8 << 20;
const LEAST = 512 << 10;
/** Files sent in parallel. */
const AT_ONCE = 3;
/** Seconds before each retry, growing with the number of failures. */
const WAITS = [1, 2, 5, 10, 20, 30];
/** Statuses worth a retry: the upload is locked, too many requests, a proxy's error. */
const LATER = [408, 409, 423, 429, 460, 502, 503, 504];
/** Codes of refusals that may last for hours, until a job ends. */
const NO_ROOM = ["queue_full", "quota_jobs"];

/**
 * Sends `[path, file]` pairs. `done` is a promise of their ids; `report({ sent, total, files,
 * waits })` is called on every step, in bytes and files; `waits` says why the upload is stalled.
 */
export function sending(files, report) {
  const total = files.reduce((sum, [, file]) => sum + file.size, 0);
  const sent = new Map();
  const requests = new Set();
  const sleepers = new Set();
  const reasons = new Set();
  let [stopped, hasBegun, finished, most] = [false, false, 0, PIECE];

  function reportProgress() {
    if (stopped) return;
    const bytes = [...sent.values()].reduce((sum, part) => sum + part, 0);
    report({ sent: bytes, total, files: finished, waits: [...reasons].join(", ") });
  }

  /**
   * Sends one request; rejects with `null` if there is no answer.
   * @param {Blob | null} body
   * @param {(bytes: number) => void} onBytes
   * @returns {Promise<XMLHttpRequest>}
   */
  function ask(method, path, headers, body = null, onBytes = () => {}) {
    return new Promise((resolve, reject) => {
      if (stopped) { reject(null); return; }
      const request = new XMLHttpRequest();
      request.open(method, path);
      for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
      request.upload.onprogress = (event) => onBytes(event.loaded);
      request.onloadend = () => {
        requests.delete(request);
        if (request.status === 0) reject(null);
        else if (request.status < 300) resolve(request);
        else reject(refusal(request));
      };
      requests.add(request);
      request.send(body);
    });
  }

  const passes = (fault) => fault === null || (LATER.includes(fault.status) && !NO_ROOM.includes(fault.code));

  /** Waits before a retry, by the number of failures. */
  async function waitOut(fault, failures) {
    if (stopped) return;
    const why = fault === null ? "Connection lost" : "Server busy";
    reasons.add(why);
    reportProgress();
    await sleep(1000 * (fault?.wait ?? WAITS[Math.min(failures, WAITS.length - 1)]));
    reasons.delete(why);
  }

  /** Repeats `step` until it is answered. */
  async function insist(step) {
    for (let failures = 0; ; failures += 1) {
      if (stopped) throw new Error("The upload was stopped.");
      try {
        return await step();
      } catch (fault) {
        if (!passes(fault)) throw fault;
        await waitOut(fault, failures);
      }
    }
  }

  /** Sleeps; ends early when the upload is stopped or the browser is back online. */
  function sleep(ms) {
    return new Promise((resolve) => {
      const wake = () => { clearTimeout(timer); sleepers.delete(wake); resolve(); };
      const timer = setTimeout(wake, ms);
      sleepers.add(wake);
    });
  }
  const wakeAll = () => { for (const wake of [...sleepers]) wake(); };

  /**
   * Whether a proxy refused a piece of `length` bytes, and smaller ones may pass; throws if none may.
   */
  function shrinks(fault, length) {
    if (fault?.status !== 413 || fault.detail !== undefined) return false;
    if (length <= LEAST) {
      throw new Error(`A proxy in front of the server refuses even pieces of ${Math.ceil(length / 1024)} KiB.\nIts administrator can allow larger request bodies.`);
    }
    most = Math.min(most, Math.max(LEAST, Math.floor(length / 2)));
    return true;
  }

  async function sendFile([path, file]) {
    const at = (bytes) => { sent.set(path, bytes); reportProgress(); };
    let id = begun.find(path, file);
    let offset = id ? await reached(id, file) : null;
    let failures = 0;
    for (;;) {
      if (offset === null) {
        id = await insist(() => begin(path, file));
        begun.keep(path, file, id);
        offset = 0;
      }
      at(offset);
      if (offset >= file.size) break;
      const length = Math.min(most, file.size - offset);
      try {
        offset = await piece(id, file, offset, length, at);
        failures = 0;
      } catch (fault) {
        const isShorter = shrinks(fault, length);
        if (!isShorter && !passes(fault) && fault.status !== 404) throw fault;
        if (!isShorter) {
          await waitOut(fault, failures);
          failures += 1;
        }
        // The server may have received part of the piece.
        offset = await reached(id, file);
      }
    }
    finished += 1;
    reportProgress();
    return id;
  }

  async function begin(path, file) {
    // Only the first ones ask for room: what has begun waits for it at its end.
    const metadata = `filename ${base64(path)}${hasBegun ? "" : `,for ${base64("job")}`}`;
    const headers = { "Tus-Resumable": "1.0.0", "Upload-Length": String(file.size), "Upload-Metadata": metadata };
    const answer = await ask("POST", UPLOADS, headers);
    hasBegun = true;
    return answer.getResponseHeader("Location").split("/").pop();
  }

  /** The bytes received of a file; `null` if its upload is gone. */
  async function reached(id, file) {
    try {
      const answer = await insist(() => ask("HEAD", `${UPLOADS}/${id}`, { "Tus-Resumable": "1.0.0" }));
      const [length, offset] = ["Upload-Length", "Upload-Offset"].map((name) => Number(answer.getResponseHeader(name)));
      return length === file.size ? offset : null;
    } catch (fault) {
      if (fault.status === 404) return null;
      throw fault;
    }
  }

  /** Sends one piece; returns the file's new offset. */
  async function piece(id, file, offset, length, at) {
    const body = file.slice(offset, offset + length);
    const headers = { "Tus-Resumable": "1.0.0", "Upload-Offset": String(offset), "Content-Type": TYPE };
    const answer = await ask("PATCH", `${UPLOADS}/${id}`, headers, body, (loaded) => at(offset + Math.min(loaded, body.size)));
    return Number(answer.getResponseHeader("Upload-Offset"));
  }

  async function all() {
    const ids = new Array(files.length);
    let next = 0;
    const worker = async () => {
      while (next < files.length) {
        const own = next;
        next += 1;
        ids[own] = await sendFile(files[own]);
      }
    };
    try {
      await Promise.all(Array.from({ length: AT_ONCE }, worker));
    } catch (fault) {
      stop();
      throw fault;
    }
    return ids;
  }

  function stop() {
    stopped = true;
    for (const request of requests) request.abort();
    wakeAll();
    removeEventListener("online", wakeAll);
  }
  addEventListener("online", wakeAll);

  return { done: all().finally(() => removeEventListener("online", wakeAll)), stop };
}

/** The refusal in a response. */
function refusal(request) {
  let problem = null;
  try {
    problem = JSON.parse(request.responseText);
  } catch { /* A proxy's answer is not a problem document. */ }
  const fault = new Refusal(request.status, problem);
  const wait = Number(request.getResponseHeader("Retry-After"));
  if (wait > 0) fault.wait = wait;
  return fault;
}

const base64 = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text)));
