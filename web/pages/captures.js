// The list of captures.

import { api, count, h, refill, when } from "../lib/dom.js";
import { rejected, thumbnail } from "../lib/photographs.js";
import { row, table } from "../lib/table.js";

const COLUMNS = [{ title: "Picture", class: "pictured", head: h("span", { class: "heard" }, "Picture") }, { title: "Name" }, { title: "Photographs" }, { title: "Size, px", class: "word" },
  { title: "Not used" }, { title: "Warnings" }, { title: "Newest jobs" }, { title: "Uploaded", class: "soft" }];
/** Jobs named for each capture. */
const NAMED = 3;
/** The API's largest page. */
const MOST = 200;
/** Delay after a failed request. */
const AGAIN_MS = 3000;

export function capturesPage(main) {
  const list = table(COLUMNS, []);
  const framed = h("div", { class: "scroll", tabIndex: 0, role: "region", "aria-label": "Table of captures", hidden: true }, list);
  const empty = h("p", { class: "hint", hidden: true }, "No captures yet. ", h("a", { href: "#/" }, "Start a job"), " to upload photographs.");
  const more = h("button", { type: "button", hidden: true }, "Show older captures");
  const problem = h("p", { class: "problem", role: "alert" });
  main.append(h("section", {}, h("h1", {}, "Captures"), h("p", { class: "hint" }, "Sets of photographs that you uploaded. You can run each of them again with other options."),
    framed, empty, more, problem));
  document.title = "Captures · fled";
  let [limit, gone, timer] = [50, false, 0];
  more.addEventListener("click", () => { limit = Math.min(limit + 50, MOST); refresh(); });

  async function refresh() {
    clearTimeout(timer);
    try {
      /** @type {import("fled-api").Captures} */
      const page = await api(`v1/captures?limit=${limit}`);
      /** @type {import("fled-api").Jobs} */
      const { jobs } = await api(`v1/jobs?limit=${MOST}`);
      if (gone) return;
      refill(list.tBodies[0], page.captures.map((capture) =>
        row(COLUMNS, cells(capture, jobs.filter((job) => job.capture_id === capture.id)))));
      framed.hidden = page.captures.length === 0;
      empty.hidden = page.captures.length > 0;
      more.hidden = !page.next_cursor || limit >= MOST;
      problem.textContent = "";
    } catch (error) {
      if (gone) return;
      problem.textContent = `${error.message} ${framed.hidden ? "Captures appear when it responds." : ""}`;
      timer = setTimeout(refresh, AGAIN_MS);
    }
  }
  refresh();
  return () => { gone = true; clearTimeout(timer); };
}

/**
 * @param {import("fled-api").Capture} capture
 * @param {import("fled-api").Job[]} jobs Its jobs among the server's newest.
 */
function cells(capture, jobs) {
  const out = rejected(capture).length;
  const warned = capture.images.filter((image) => image.warnings.length > 0).length;
  const first = capture.images.find((image) => image.accepted);
  return [first ? thumbnail(capture, first) : "", h("a", { href: `#/captures/${capture.id}` }, capture.name || "unnamed"), String(capture.accepted), sizes(capture),
    out > 0 ? h("span", { class: "bad" }, String(out)) : "", warned > 0 ? `on ${count(warned, "photograph")}` : "", jobs.length > 0 ? named(jobs) : "", when(capture.created_at)];
}

/** The size of its photographs, if they all have the same. */
function sizes({ images }) {
  const all = new Set(images.filter(({ accepted }) => accepted).map(({ width, height }) => `${width} × ${height}`));
  return all.size > 1 ? "mixed" : [...all].join("");
}

function named(jobs) {
  const rest = jobs.length - NAMED;
  return h("span", {}, jobs.slice(0, NAMED).flatMap((job, i) => [i > 0 ? ", " : "", h("a", { href: `#/jobs/${job.id}` }, job.name || "unnamed")]),
    rest > 0 ? ` and ${rest} more` : "");
}
