// Whoever comes by a link to one job: `#/share/JOB/SECRET`.

import { api, h } from "./dom.js";
import { session } from "./login.js";

/** What such an address names: `[job, secret]`; `null` for others. */
export function link(hash) {
  const found = hash.match(/^#\/share\/([0-9a-f-]+)\/(fled_[0-9a-f]+)$/);
  return found && [found[1], found[2]];
}

/** Opens the job of a link, then shows its page; `enter` looks again at who one is. */
export function openLink(main, [job, secret], enter) {
  const line = h("p", { class: "hint", role: "status" }, "Opening the job…");
  main.append(h("section", {}, line));
  open().catch((error) => {
    line.className = "problem";
    line.textContent = `This link opens nothing: it has ended or is not whole.\n${error.message}`;
  });

  async function open() {
    // Whoever sees the job already keeps the session that they have.
    const { needed, scopes } = await session();
    const seen = !needed || (scopes !== null && (await fetch(`/v1/jobs/${job}`)).ok);
    if (!seen) {
      const body = JSON.stringify({ token: secret });
      await api("/login", { method: "POST", headers: { "Content-Type": "application/json" }, body });
    }
    // Out of the address, and so out of the history and of what is copied from there.
    history.replaceState(null, "", `#/jobs/${job}`);
    enter();
  }
  return () => {};
}
