// A finished job's result in formats for other programs.

import { api, count, h, size } from "../lib/dom.js";

/** The export formats of the result, each with its purpose; `null` if there is none. */
export async function exportList(base) {
  const found = await api(`${base}/exports`).catch(() => null);
  if (!found?.exports.length) return null;
  const list = h("ul", { class: "exports bare" }, found.exports.map(({ name, about, bytes }) => h("li", { class: "row" },
    h("a", { class: "button", href: `${base}/exports/${name}`, download: name }, name),
    // It is made while being sent.
    h("span", { class: "soft" }, `about ${size(bytes)}`),
    h("span", { class: "about" }, about))));
  return Object.assign(list, { gist: count(found.exports.length, "format") });
}
