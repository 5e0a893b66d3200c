// The capture that new photographs are added to: `#/?add=ID`.

import { api, count, h } from "../lib/dom.js";
import { asked, keep } from "../lib/place.js";

/** `{ root, id() }`: what the form says of the capture, and its id, if there is one. */
export function earlier() {
  let id = asked().get("add") ?? "";
  const words = h("span", { role: "status" });
  const root = h("p", { class: "row", hidden: !id }, words,
    h("button", { type: "button", class: "small", onclick: leave }, "Start without them"));

  function leave() {
    id = "";
    root.hidden = true;
    keep({ ...Object.fromEntries(asked()), add: "" });
  }

  async function show() {
    try {
      /** @type {import("fled-api").Capture} */
      const capture = await api(`v1/captures/${id}`);
      words.replaceChildren(`What you choose is added to the ${count(capture.accepted, "photograph")} of `,
        h("a", { href: `#/captures/${id}` }, capture.name || "an unnamed capture"), ". They are not sent again.");
    } catch (error) {
      words.textContent = error.status === 404 ? "The capture to add to is gone." : error.message;
    }
  }
  if (id) show();
  return { root, id: () => id };
}
