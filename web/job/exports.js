// A finished job's result in the forms in which other programs go on with it.

import { api, count, h, size } from "../lib/dom.js";

/** The forms that the result can be had in, each with what it is for; `null` where there is none. */
export async function exportList(base) {
  const found = await api(`${base}/exports`).catch(() => null);
  if (!found?.exports.length) return null;
  const list = h("ul", { class: "exports bare" }, found.exports.map(({ name, about, bytes }) => h("li", { class: "row" },
    h("a", { class: "button", href: `${base}/exports/${name}`, download: name }, name),
    // It is made while it is sent.
    h("span", { class: "soft" }, `about ${size(bytes)}`),
    h("span", { class: "about" }, about))));
  return Object.assign(list, { gist: count(found.exports.length, "format") });
}
