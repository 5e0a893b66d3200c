// Builds the page. External text (names, log lines, warnings) only ever becomes a text node.

/**
 * An element with properties, attributes (`data-`, `aria-`, `class`) and children.
 * @returns {any} An element of the tag's type.
 */
 export function h(tag, properties = {}, ...children) {
  return fill(document.createElement(tag), properties, children);
}

/**
 * The same for SVG.
 * @returns {any} An element of the tag's type.
 */
 export function s(tag, attributes = {}, ...children) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children, true);
}

function fill(node, properties, children, svg = false) {
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value === undefined) continue;
    else if (svg || name === "class" || name === "role" || name.includes("-")) node.setAttribute(name, value);
    else node[name] = value;
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

/** An element's identity across redraws; a link's is its target. */
const keyOf = (element) => element.dataset.key ?? element.getAttribute("href");

/**
 * Replaces the children of a node on each redraw; links and elements with a `data-key` keep the
 * focus.
 */
export function refill(node, ...children) {
  const held = node.contains(document.activeElement) ? keyOf(document.activeElement) : null;
  node.replaceChildren(...children.flat());
  if (!held) return;
  const same = [...node.querySelectorAll("a, [data-key]")].find((one) => keyOf(one) === held);
  same?.focus({ preventScroll: true });
}

/**
 * An error response: its message, `status`, `pointer` to the part at fault, and `wait`, the seconds
 * until a retry, if given.
 */
export class Refusal extends Error {
  /** @type {number | undefined} */
  wait;

  /**
   * @param {number} status
   * @param {import("fled-api").Problem | null} problem `null` for any other body.
   */
  constructor(status, problem) {
    super([problem?.detail ?? `The server responded with status ${status}.`, problem?.hint].filter(Boolean).join("\n"));
    Object.assign(this, { status, code: problem?.code, detail: problem?.detail, pointer: problem?.pointer, capture: problem?.capture });
  }
}

/** The server's clock minus ours, ms; its times are compared with its own clock. */
let ahead = 0;
/** Smaller differences are ignored, as `Date` has whole seconds, ms. */
const SAME = 2000;

export const serverNow = () => Date.now() + ahead;

/**
 * The response to a GET or other request; a problem document becomes a `Refusal`. If the server
 * does not answer, the window receives an `unanswered` event.
 * @param {string} path
 * @param {RequestInit} options
 */
export async function answer(path, options = {}) {
  const response = await fetch(path, options).catch((error) => {
    if (options.signal?.aborted) throw error;
    dispatchEvent(new Event("unanswered"));
    throw new Error("The server is not responding.");
  });
  const date = Date.parse(response.headers.get("date"));
  if (Math.abs(date - serverNow()) > SAME) ahead = date - Date.now();
  if (response.ok) return response;
  throw new Refusal(response.status, await response.json().catch(() => null));
}

/**
 * The JSON of an `answer`, `null` if it has none.
 * @param {string} path
 * @param {RequestInit} options
 * @returns {Promise<any>} Of the type that the caller expects.
 */
export async function api(path, options = {}) {
  const response = await answer(path, options);
  return response.status === 204 ? null : response.json();
}

/** A request whose body is JSON. */
export const send = (path, body, method = "POST") =>
  api(path, { method, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });

/** 75 -> "1 min 15 s". */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "";
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${whole % 60} s`;
  return `${Math.floor(whole / 3600)} h ${Math.floor((whole % 3600) / 60)} min`;
}

/** 42 -> "0:42", for times that count up on the page. */
export function stopwatch(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  const two = (part) => String(part).padStart(2, "0");
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor((whole % 3600) / 60)];
  return hours > 0 ? `${hours}:${two(minutes)}:${two(whole % 60)}` : `${minutes}:${two(whole % 60)}`;
}

/** 2,500 -> "2.5 kB". */
export function size(bytes) {
  if (bytes < 1000) return `${bytes} B`;
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(1)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}

/** "1 photograph", "2 photographs". */
export const count = (number, word) => `${number.toLocaleString()} ${word}${number === 1 ? "" : "s"}`;

/** A time in this browser's format. */
export const when = (time) => new Date(time).toLocaleString();

/** A path with each part encoded for a URL. */
export const address = (path) => path.split("/").map(encodeURIComponent).join("/");

/** "held_out" -> "held out". */
export const plain = (word) => String(word).replaceAll("_", " ");

/** Our own text as nodes, with names between backticks. */
export const prose = (text) => text.replaceAll(/\s+/g, " ").split("`").map((part, i) => (i % 2 ? h("code", {}, part) : part));

/** A part of a page with a title; `show` fills and hides it. */
export function section(title) {
  const node = h("section", { hidden: true }, h("h2", {}, title));
  node.content = h("div");
  node.append(node.content);
  return node;
}

/** Whether the page is as narrow as a phone's, where a long page would be too long. */
export const isNarrow = () => matchMedia("(max-width: 620px)").matches;

/** A line that unfolds its content; it is open on a wide page. */
export const fold = (title, ...content) =>
  h("details", { class: "fold", open: !isNarrow() }, h("summary", {}, title), ...content);

/** A `section` that is folded on a phone, where its title includes the `gist` of its content. */
export function folding(title) {
  const gist = h("span", { class: "soft gist" });
  const content = h("div");
  const node = h("section", { hidden: true }, fold(h("span", {}, h("h2", {}, title), gist), content));
  return Object.assign(node, { content, gist });
}

export function show(node, ...content) {
  const real = content.filter(Boolean);
  node.hidden = real.length === 0;
  if (real.length > 0) node.content.replaceChildren(...real.flat());
  if (!node.gist) return;
  node.gist.textContent = real.map((one) => one.gist).filter(Boolean).join(" · ");
}

/** Replaces a page with a sentence and a link back. */
export function nothing(main, words, href = "#/", where = "All jobs") {
  main.replaceChildren(h("section", {}, h("p", { role: "alert" }, words), h("p", {}, h("a", { href }, where))));
}
