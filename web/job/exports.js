// A finished job's result in formats for other programs.

import { api, count, h, size } from "../lib/dom.js";
import { explained } from "../lib/download.js";
import { shapingQuery } from "../lib/shaping.js";

/**
 * The export formats of the result, each with its purpose, as the user has shaped them in the
 * scene; `null` if there is none.
 */
export async function exportList(base, shaping) {
  /** @type {import("fled-api").Exports | null} */
  const found = await api(`${base}/exports`).catch(() => null);
  if (!found?.exports.length) return null;
  const rows = found.exports.map((one) => row(base, one));
  const notice = h("div", { class: "notices shaped", role: "status" });
  const list = h("ul", { class: "exports bare" }, rows.map((one) => one.root));
  const root = h("div", {}, notice, list);
  let said = "";
  const show = () => {
    const now = notices(shaping);
    const words = now.map((line) => line.textContent).join();
    // What has not changed need not be read out again.
    if (words !== said) notice.replaceChildren(...now);
    said = words;
    notice.hidden = notice.childElementCount === 0;
    for (const one of rows) one.show(shaping.now);
  };
  show();
  shaping.change({ isOffered: true });
  // A newer list takes the place of this one.
  const deaf = shaping.heard(() => (root.isConnected ? show() : deaf()));
  return Object.assign(root, { gist: count(found.exports.length, "format") });
}

function row(base, { name, about, bytes, has_scene: hasScene }) {
  const link = h("a", { class: "button", download: name }, name);
  const weight = h("span", { class: "soft" });
  const note = h("p", { class: "note", role: "status" });
  const isMesh = name.startsWith("mesh.");
  let isShaped = false;
  const end = explained(link, note, () => isMesh || isShaped);
  return {
    root: h("li", { class: "row" }, link, weight, h("span", { class: "about" }, about), note),
    show({ crop, scale }) {
      const isCropped = hasScene && crop !== null;
      isShaped = isCropped || (hasScene && scale !== null);
      const href = `${base}/exports/${name}${hasScene ? shapingQuery({ crop, scale }) : ""}`;
      if (href !== link.getAttribute("href")) end();
      link.href = href;
      // It is made while being sent.
      weight.textContent = `${isCropped ? "at most" : "about"} ${size(bytes)}`;
    },
  };
}

/** What applies to all scenes and meshes, each with a button that drops it. */
function notices(shaping) {
  const { crop, scale } = shaping.now;
  const line = (words, drop, some) => h("p", { class: "row" }, words,
    h("button", { type: "button", onclick: () => shaping.change(some) }, drop));
  return [
    crop && line(`Scenes and meshes are cropped to the ${crop.shape} drawn in the 3D view.`,
      "Export everything", { crop: null }),
    scale !== null && line("Lengths in scenes and meshes are in metres: "
      + `1 unit is ${scale} m, as measured in the 3D view. Cameras and the COLMAP model keep their `
      + "units.", "Export as it is", { scale: null }),
  ].filter(Boolean);
}
