// Builds the page. Text from outside (names, log lines, warnings) only ever becomes a text node.

/** An element with properties, attributes (`data-`, `aria-`, `class`) and children. */
export function h(tag, properties = {}, ...children) {
  return fill(document.createElement(tag), properties, children);
}

/** The same for SVG. */
export function s(tag, attributes = {}, ...children) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children, true);
}

function fill(node, properties, children, svg = false) {
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (svg || name === "class" || name.includes("-")) node.setAttribute(name, value);
    else if (value !== undefined) node[name] = value;
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

/** A GET or other request; a problem document becomes an Error with its words. */
export async function api(path, options = {}) {
  const response = await fetch(path, options);
  if (response.ok) return response.status === 204 ? null : response.json();
  throw new Error(await words(response));
}

async function words(response) {
  try {
    const problem = await response.json();
    return [problem.detail, problem.hint].filter(Boolean).join("\n");
  } catch {
    return `The server answered ${response.status}.`;
  }
}

/** 75 -> "1 min 15 s". */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "";
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${whole % 60} s`;
  return `${Math.floor(whole / 3600)} h ${Math.floor((whole % 3600) / 60)} min`;
}

/** A path with each part made safe for an address. */
export const address = (path) => path.split("/").map(encodeURIComponent).join("/");

/** "held_out" -> "held out". */
export const plain = (word) => String(word).replaceAll("_", " ");

/** The pill that shows a state. */
export const pill = (job) => h("span", { class: `state ${job.state}` }, job.cancel_requested && job.state === "running" ? "cancelling" : job.state);

/** What a job does now, in a few words. */
export function doing(job) {
  if (job.state !== "running") return job.error && job.state === "queued" ? "waits for another attempt" : "";
  const round = job.round > 0 ? `round ${job.round} of ${job.rounds}` : "";
  return [round, job.stage].filter(Boolean).join(", ") || "starts";
}
