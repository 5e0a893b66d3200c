// Visitors by a link to one job: `#/share/JOB/SECRET`.

import { ask } from "../lib/dialog.js";
import { api, h } from "../lib/dom.js";
import { session } from "../lib/login.js";

/** Opens the job of a link, then shows its page; `enter` reads the session again. */
export function openLink(main, [job, secret], enter) {
  const line = h("p", { class: "hint", role: "status" }, "Opening the job…");
  main.append(h("section", {}, line));
  open().catch((error) => {
    line.className = "problem";
    line.textContent = `This link does not work. It may be incomplete, expired or revoked, or the server may be busy.\n${error.message}`;
  });

  async function open() {
    const { needed, scopes } = await session();
    // A browser that already sees the job keeps its session.
    if (needed && (scopes === null || !(await seen()))) {
      if (scopes !== null && !(await ask("Open this link?", "Your current login cannot see this job. If you open the link, you see only this job until you log out.", "Open link", "Stay here"))) {
        location.hash = "#/";
        return;
      }
      const body = JSON.stringify({ token: secret });
      await api("login", { method: "POST", headers: { "Content-Type": "application/json" }, body });
    }
    // Removes the secret from the address, and so from the history and from copied addresses.
    history.replaceState(null, "", `#/jobs/${job}`);
    enter();
  }
  /** Whether this browser's session may see the job. */
  async function seen() {
    const { ok, status } = await fetch(`v1/jobs/${job}`);
    if (!ok && ![401, 403, 404].includes(status)) throw new Error(`The server responded with status ${status}.`);
    return ok;
  }
  return () => {};
}
