// The log of a job, as it grows.

import { api, count, folding, h } from "../lib/dom.js";

const LOG_MS = 2000;

export function logView(base) {
  const text = h("pre", { tabIndex: 0, "aria-label": "Log" });
  const root = folding("Log");
  root.content.append(text);
  let [lines, offset, timer, active, busy, begun] = [0, 0, 0, false, false, false];

  async function read() {
    if (busy) return;
    busy = true;
    clearTimeout(timer);
    try {
      for (let end = false; !end;) {
        /** @type {import("fled-api").LogPage} */
        const page = await api(`${base}/log?offset=${offset}&limit=2000`);
        const below = text.scrollHeight - text.scrollTop - text.clientHeight < 30;
        if (page.lines.length > 0) text.append(`${page.lines.join("\n")}\n`);
        lines += page.lines.length;
        root.gist.textContent = count(lines, "line");
        // A waiting job has logged nothing yet.
        root.hidden = text.textContent === "";
        if (below) text.scrollTop = text.scrollHeight;
        offset = page.next_offset;
        end = page.end;
      }
    } catch { /* The next read continues where this one ended. */ }
    busy = false;
    if (active) timer = setTimeout(read, LOG_MS);
  }
  return {
    root,
    follow(now) {
      // Reads again at the end, because the last lines matter most.
      if (!begun || now !== active) { [begun, active] = [true, now]; read(); }
    },
    leave() { active = false; clearTimeout(timer); },
  };
}
