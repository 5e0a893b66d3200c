// The capture that new photographs are added to: `#/?add=ID`.

import { api, count, h } from "../lib/dom.js";
import { asked, keep } from "../lib/place.js";

/** What is sent alone, never with photographs. */
const [ZIP, VIDEO] = [/\.zip$/i, /\.(mp4|mov|m4v)$/i];

/**
 * `{ root, id(), fault(files) }`: what the form says of the capture, its id, if there is one, and
 * why `[path, file]` pairs cannot be added to it, if they cannot.
 */
export function earlier() {
  let id = asked().get("add") ?? "";
  const words = h("span", { role: "status" });
  const root = h("p", { class: "row", hidden: !id }, words,
    h("button", { type: "button", class: "small", onclick: leave }, "Start without them"));

  function forget() {
    id = "";
    keep({ ...Object.fromEntries(asked()), add: "" });
  }
  function leave() {
    forget();
    root.hidden = true;
  }

  /** @param {[string, File][]} files */
  function fault(files) {
    if (!id || files.length === 0) return "";
    const isAlone = files.some(([path]) => ZIP.test(path)) || files.every(([path]) => VIDEO.test(path));
    return isAlone ? "A ZIP file or a video cannot be added to a capture: choose photographs." : "";
  }

  async function show() {
    try {
      /** @type {import("fled-api").Capture} */
      const capture = await api(`v1/captures/${id}`);
      words.replaceChildren(`What you choose is added to the ${count(capture.accepted, "photograph")} of `,
        h("a", { href: `#/captures/${id}` }, capture.name || "an unnamed capture"), ". They are not sent again.");
    } catch (error) {
      words.textContent = error.status === 404 ? "The capture to add to is gone." : error.message;
      if (error.status === 404) forget();
    }
  }
  if (id) show();
  return { root, id: () => id, fault };
}
