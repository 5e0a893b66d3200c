// Downloads that the server may refuse, with its reason on the page.

import { answer, h } from "./dom.js";

/** How long a saved file stays in memory for the browser to read it, ms. */
const READ = 60_000;

/** Has the browser save a blob as a file. */
export function saved(blob, name) {
  const href = URL.createObjectURL(blob);
  h("a", { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), READ);
}

/**
 * Downloads the target of `link` within the page if `isRefusable()`, and shows a refusal in `note`:
 * the browser itself would only report a failed download. Returns a function that ends a download
 * and empties the note.
 */
export function explained(link, note, isRefusable) {
  /** @type {AbortController | null} */
  let running = null;
  const show = (words, isRefusal = false) => {
    note.classList.toggle("problem", isRefusal);
    note.textContent = words;
  };
  const end = () => {
    running?.abort();
    running = null;
    show("");
  };
  link.addEventListener("click", async (event) => {
    const isPlain = !(event.ctrlKey || event.metaKey || event.shiftKey || event.altKey);
    if (!isPlain || !isRefusable()) return;
    event.preventDefault();
    if (running) return;
    const stop = new AbortController();
    running = stop;
    const { download: name, href } = link;
    show(`Preparing ${name} …`);
    try {
      const response = await answer(href, { signal: stop.signal });
      const blob = await response.blob().catch(() => {
        throw new Error("The download was interrupted.");
      });
      if (running !== stop) return;
      end();
      saved(blob, name);
    } catch (error) {
      if (running !== stop) return;
      end();
      show(error.message, true);
    }
  });
  return end;
}
