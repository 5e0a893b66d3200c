// The list of captures.

import { api, count, h, refill, when } from "../lib/dom.js";
import { rejected } from "../lib/photographs.js";
import { row, table } from "../lib/table.js";

const COLUMNS = [{ title: "Name" }, { title: "Photographs" }, { title: "Not used" }, { title: "Warnings" }, { title: "Uploaded", class: "soft" }];
/** The API's largest page. */
const MOST = 200;
/** Delay after a failed request. */
const AGAIN_MS = 3000;

export function capturesPage(main) {
  const list = table(COLUMNS, []);
  list.hidden = true;
  const empty = h("p", { class: "hint", hidden: true }, "No captures yet. ", h("a", { href: "#/" }, "Start a job"), " to upload photographs.");
  const more = h("button", { type: "button", hidden: true }, "Show older captures");
  const problem = h("p", { class: "problem", role: "alert" });
  main.append(h("section", {}, h("h1", {}, "Captures"), h("p", { class: "hint" }, "Sets of photographs that you uploaded. You can run each of them again with other options."),
    list, empty, more, problem));
  document.title = "Captures · fled";
  let [limit, gone, timer] = [50, false, 0];
  more.addEventListener("click", () => { limit = Math.min(limit + 50, MOST); refresh(); });

  async function refresh() {
    clearTimeout(timer);
    try {
      /** @type {import("fled-api").Captures} */
      const page = await api(`/v1/captures?limit=${limit}`);
      if (gone) return;
      refill(list.tBodies[0], page.captures.map((capture) => row(COLUMNS, cells(capture))));
      list.hidden = page.captures.length === 0;
      empty.hidden = page.captures.length > 0;
      more.hidden = !page.next_cursor || limit >= MOST;
      problem.textContent = "";
    } catch (error) {
      if (gone) return;
      problem.textContent = `${error.message} ${list.hidden ? "Captures appear when it responds." : ""}`;
      timer = setTimeout(refresh, AGAIN_MS);
    }
  }
  refresh();
  return () => { gone = true; clearTimeout(timer); };
}

/** @param {import("fled-api").Capture} capture */
function cells(capture) {
  const out = rejected(capture).length;
  const warned = capture.images.filter((image) => image.warnings.length > 0).length;
  return [h("a", { href: `#/captures/${capture.id}` }, capture.name || "unnamed"), String(capture.accepted),
    out > 0 ? h("span", { class: "bad" }, String(out)) : "", warned > 0 ? `on ${count(warned, "photograph")}` : "", when(capture.created_at)];
}
