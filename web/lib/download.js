// Downloads that the server may refuse, with its reason on the page.

import { answer, h } from "./dom.js";

/** How long a saved file stays in memory for the browser to read it, ms. */
const READ = 10_000;

/** Has the browser save a blob as a file. */
export function saved(blob, name) {
  const href = URL.createObjectURL(blob);
  h("a", { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), READ);
}

/**
 * Requests the target of `link` before the browser downloads it, and shows a refusal in `note`: the
 * browser itself would only report a failed download. `isRefusable()` is whether to. What the
 * server makes as a whole (`isWhole`) is not requested twice.
 */
export function explained(link, note, isRefusable, isWhole = false) {
  let isBusy = false;
  const show = (words, kind = "soft") => {
    note.className = kind;
    note.textContent = words;
  };
  link.addEventListener("click", async (event) => {
    const isPlain = !(event.ctrlKey || event.metaKey || event.shiftKey || event.altKey);
    if (!isPlain || !isRefusable()) return;
    event.preventDefault();
    if (isBusy) return;
    isBusy = true;
    show(`Preparing ${link.download} …`);
    const { download: name, href } = link;
    const stop = new AbortController();
    try {
      const response = await answer(href, { signal: stop.signal });
      if (isWhole) saved(await response.blob(), name);
      else h("a", { href, download: name }).click();
      show("");
    } catch (error) {
      show(error.message, "problem");
    }
    stop.abort();
    isBusy = false;
  });
}
