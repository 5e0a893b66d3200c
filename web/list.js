// The list of jobs, below the form that starts one.

import { api, duration, h, plain, refill, when } from "./dom.js";
import { selection } from "./selection.js";
import { doing, pill, setBar } from "./state.js";
import { row, table } from "./table.js";
import { startForm } from "./upload.js";

const REFRESH_MS = 1500;
/** The API's largest page. */
const MOST = 200;

const COLUMNS = [{ title: "Mark", class: "pick", head: h("span", { class: "heard" }, "Mark") }, { title: "Name" }, { title: "State" }, { title: "Progress" }, { title: "Now" },
  { title: "Left", class: "word" }, { title: "Preset", class: "word" }, { title: "Created", class: "soft" }];

/** Jobs as a table that is drawn again, with a bar for those that are marked: `{ root, update(jobs) }`. */
export function jobTable(refresh) {
  const list = table(COLUMNS, []);
  const marked = selection(refresh);
  const root = h("div", { hidden: true }, list, marked.root);
  const body = list.tBodies[0];
  let shown = "";
  return {
    root,
    update(jobs) {
      const now = JSON.stringify(jobs);
      if (now === shown) return;
      shown = now;
      root.hidden = false;
      list.hidden = jobs.length === 0;
      refill(body, jobs.map((job) => row(COLUMNS, [marked.box(job), ...cells(job)])));
      marked.update(jobs);
    },
  };
}

function cells(job) {
  const bar = h("progress", { max: 1, "aria-label": "progress" });
  setBar(bar, job);
  return [h("a", { href: `#/jobs/${job.id}` }, job.name || "unnamed"), pill(job), bar,
    doing(job) || (job.error ? plain(job.error.code) : ""), job.state === "running" ? duration(job.eta_seconds) : "",
    job.preset, when(job.created_at)];
}

export function listPage(main) {
  const jobs = jobTable(() => refresh());
  const empty = h("p", { class: "hint", hidden: true }, "No job yet. Start with a folder of 20 to 60 overlapping photographs of a place in which nothing moves.");
  const more = h("button", { type: "button", hidden: true }, "Older jobs");
  const form = startForm();
  const list = h("section", { hidden: true }, h("h2", {}, "Jobs"), jobs.root, empty, more);
  main.append(form.root, list);
  let [limit, timer, gone] = [50, 0, false];
  more.addEventListener("click", () => { limit = Math.min(limit + 50, MOST); refresh(); });

  async function refresh() {
    clearTimeout(timer);
    try {
      const page = await api(`/v1/jobs?limit=${limit}`);
      if (gone) return;
      jobs.update(page.jobs);
      list.hidden = false;
      empty.hidden = page.jobs.length > 0;
      more.hidden = !page.next_cursor || limit >= MOST;
    } catch { /* The health line says so; the next round may succeed. */ }
    if (!gone) timer = setTimeout(refresh, REFRESH_MS);
  }
  refresh();
  return () => { gone = true; clearTimeout(timer); form.leave(); };
}
