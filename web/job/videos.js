// Videos of a finished scene: requests, progress and playback.

import { ask } from "../lib/dialog.js";
import { api, count, folding, h, send, show, size, when } from "../lib/dom.js";
import { cropText } from "../lib/shaping.js";

/** Interval of requests while a video is made. */
const LOOK_MS = 1000;
const WAYS = {
  orbit: ["Around the scene", "Swings to both sides as far as the photographs reach, or circles the scene if they go all the way around."],
  cameras: ["Through the photographs", "Moves from camera to camera, in the order of the photographs' names."],
};
const SECONDS = [4, 8, 15, 30, 60];
const SIDES = [640, 960, 1280, 1920];

/**
 * The section of job `id`; a visitor by a link sees the videos but makes none. New videos show only
 * the inside of the crop of `shaping`.
 */
export function videos(id, isVisitor, shaping) {
  const base = `v1/jobs/${id}/videos`;
  const root = folding("Videos");
  const problem = h("p", { class: "problem", role: "alert" });
  const list = h("ul", { class: "videos bare" });
  const options = (values, usual, label) => values.map((value) =>
    h("option", { value: String(value), selected: value === usual }, label(value)));
  const way = h("select", {}, Object.entries(WAYS).map(([kind, [label]]) => h("option", { value: kind }, label)));
  const seconds = h("select", {}, options(SECONDS, 8, (value) => `${value} s`));
  const side = h("select", {}, options(SIDES, 960, (value) => `${value} px`));
  const button = h("button", { type: "submit" }, "Create video");
  const about = h("p", { class: "hint" });
  const form = h("form", { onsubmit: make }, h("label", {}, "Path", way), h("label", {}, "Length", seconds),
    h("label", {}, "Long side", side), button);
  const content = h("div", {}, !isVisitor && form, !isVisitor && about, problem, list);
  const items = new Map();
  let [timer, gone, isOpen, isUpright] = [0, false, false, false];

  const explain = () => {
    const { crop } = shaping.now;
    const part = crop ? ` Shows only the inside of the ${crop.shape} drawn in the 3D view.` : "";
    about.textContent = WAYS[way.value][1] + part;
  };
  way.addEventListener("change", explain);
  const deaf = shaping.heard(explain);
  explain();

  async function make(event) {
    event.preventDefault();
    button.disabled = true;
    problem.textContent = "";
    try {
      const long = { [isUpright ? "height" : "width"]: Number(side.value) };
      const { crop } = shaping.now;
      const part = crop ? { crop: cropText(crop) } : {};
      await send(base, { kind: way.value, seconds: Number(seconds.value), ...long, ...part });
      await look();
    } catch (error) {
      problem.textContent = error.message;
    }
    button.disabled = false;
  }

  async function remove(video) {
    const isMade = video.state === "succeeded";
    if (isMade && !(await ask("Delete this video?", "You can create it again.", "Delete video"))) return;
    problem.textContent = "";
    try {
      await api(`${base}/${video.id}`, { method: "DELETE" });
      await look();
      // The focused element is gone.
      button.focus();
    } catch (error) {
      problem.textContent = error.message;
    }
  }

  async function look() {
    clearTimeout(timer);
    let found = [];
    try {
      ({ videos: found } = await api(base));
    } catch (error) {
      if (!gone) problem.textContent = error.message;
      return;
    }
    if (gone) return;
    for (const known of [...items.keys()]) {
      if (!found.some((video) => video.id === known)) items.delete(known);
    }
    // A video that plays is not redrawn while another is made.
    const rows = found.map((video) => {
      const known = items.get(video.id);
      if (known?.state === video.state) {
        known.update(video);
        return known.node;
      }
      const item = entry(base, video, isVisitor ? null : () => remove(video));
      items.set(video.id, item);
      return item.node;
    });
    for (const node of [...list.children]) if (!rows.includes(node)) node.remove();
    rows.forEach((row, at) => { if (list.children[at] !== row) list.insertBefore(row, list.children[at] ?? null); });
    const isShown = !isVisitor || found.length > 0;
    if (root.hidden === isShown) show(root, isShown && content);
    root.gist.textContent = found.length > 0 ? count(found.length, "video") : "none yet";
    if (found.some((video) => ["queued", "running"].includes(video.state))) timer = setTimeout(look, LOOK_MS);
  }

  return {
    root,
    /** Opens the section of a finished job; `cameras` are those of its views. */
    open(cameras) {
      if (isOpen) return;
      isOpen = true;
      isUpright = cameras.length > 0 && cameras[0].height > cameras[0].width;
      look();
    },
    leave() {
      gone = true;
      deaf();
      clearTimeout(timer);
    },
  };
}

/** One video in its current state: `{ state, node, update }`. */
function entry(base, video, remove) {
  const words = `${WAYS[video.kind]?.[0] ?? "Custom path"}${video.crop ? ", cropped" : ""}, ${Math.round(10 * video.seconds) / 10} s, ${video.width} × ${video.height} px`;
  const line = h("span", { class: "soft now", role: "status" });
  const bar = h("progress", { max: 1, "aria-label": `Progress of the video: ${words}` });
  const file = `${base}/${video.id}/file`;
  const end = (label, style) => remove && h("button", { type: "button", class: style, onclick: remove }, label);
  const head = (...more) => h("div", { class: "row" }, h("span", {}, words), h("span", { class: "soft" }, when(video.created_at)), line, h("span", { class: "row push" }, ...more.filter(Boolean)));
  if (video.state === "succeeded") {
    line.textContent = size(video.bytes);
    const player = h("video", { controls: true, preload: "metadata", playsInline: true, loop: video.kind === "orbit",
      width: video.width, height: video.height, src: file, "aria-label": words });
    const download = h("a", { class: "button", href: file, download: `${video.kind}-${video.width}x${video.height}.mp4` }, "Download");
    return { state: video.state, update() {}, node: h("li", {}, head(download, end("Delete", "danger")), player) };
  }
  if (video.state === "failed") {
    const { detail, hint } = video.error;
    return { state: video.state, update() {}, node: h("li", {}, head(end("Remove", "")), h("p", { class: "problem" }, `The video could not be created: ${detail}\n${hint}`)) };
  }
  function update({ state, progress, ahead }) {
    const before = ahead > 0 ? `waiting for ${count(ahead, "other video")}` : "starting soon";
    line.textContent = state === "queued" ? before : `${Math.round(100 * progress)} %`;
    if (progress > 0) bar.value = progress;
    else bar.removeAttribute("value");
  }
  update(video);
  return { state: video.state, update, node: h("li", {}, head(end("Cancel", "")), bar) };
}
