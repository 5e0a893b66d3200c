// Links that open one job to anyone who has them.

import { api, h } from "../lib/dom.js";

/** The section of a job's page that makes and revokes links. */
export function shares(job) {
  const base = `v1/jobs/${job}/shares`;
  const problem = h("p", { class: "problem", role: "alert" });
  const made = h("div");
  const list = h("div");
  const name = h("input", { type: "text", maxLength: 100, placeholder: "Recipient" });
  const days = h("select", {}, [[1, "1 day"], [7, "1 week"], [30, "30 days"], [365, "1 year"]]
    .map(([value, label]) => h("option", { value: String(value), selected: value === 30 }, label)));
  const button = h("button", { type: "submit" }, "Create link");
  const root = h("section", { hidden: true }, h("h2", {}, "Share"),
    h("p", { class: "hint" }, "Anyone with the link can see this job's pictures, scene and files, and nothing else."),
    h("form", { class: "row", onsubmit: make }, h("label", {}, "Name ", name), h("label", {}, "Expires after ", days), button),
    made, list, problem);

  async function make(event) {
    event.preventDefault();
    button.disabled = true;
    problem.textContent = "";
    try {
      const body = JSON.stringify({ name: name.value, days: Number(days.value) });
      /** @type {import("fled-api").MadeShare} */
      const share = await api(base, { method: "POST", headers: { "Content-Type": "application/json" }, body });
      show(share);
      name.value = "";
      await refresh();
    } catch (error) {
      problem.textContent = error.message;
    }
    button.disabled = false;
  }

  /** Shows the link, which the server sends only once. */
  function show(share) {
    const link = new URL(`.${share.path}`, location.href).href;
    const source = link.replace("/#/share/", "/embed#");
    const frame = `<iframe src="${source}" title="3D scene" width="800" height="600" style="border:0" allow="fullscreen"></iframe>`;
    const address = shown("Link", link);
    made.replaceChildren(address, shown("Embed", frame),
      h("p", { class: "hint" }, "Copy the link now. It is not shown again. The second shows the scene in a page of yours."));
    address.querySelector("input").select();
  }

  function shown(name, value) {
    const address = h("input", { type: "text", readOnly: true, size: 60, value, "aria-label": name });
    const copy = h("button", { type: "button", "aria-label": `Copy ${name.toLowerCase()}`, onclick: copied }, "Copy");
    async function copied() {
      address.select();
      try {
        await navigator.clipboard.writeText(address.value);
        copy.textContent = "Copied";
      } catch {
        // Without TLS a page may not use the clipboard; a selection can be copied by hand.
        copy.textContent = "Selected: copy it";
      }
    }
    return h("p", { class: "row" }, address, copy);
  }

  async function end(share, event) {
    event.target.disabled = true;
    problem.textContent = "";
    try {
      await api(`${base}/${share.id}`, { method: "DELETE" });
      made.replaceChildren();
      await refresh();
    } catch (error) {
      problem.textContent = error.message;
      event.target.disabled = false;
    }
  }

  async function refresh() {
    /** @type {import("fled-api").Shares} */
    const { shares } = await api(base);
    const used = (share) => (share.last_used_at ? `last used ${day(share.last_used_at)}` : "not used yet");
    list.replaceChildren(...(shares.length === 0 ? [] : [h("ul", { class: "plain" }, shares.map((share) => h("li", { class: "row" },
      h("strong", {}, share.name || "Unnamed link"), h("span", { class: "soft" }, `until ${day(share.expires_at)} · ${used(share)}`),
      h("button", { type: "button", "aria-label": `Revoke ${share.name || "unnamed link"}`, onclick: (event) => end(share, event) }, "Revoke"))))]));
  }

  return {
    root,
    /** If the server needs no tokens, links have no purpose and the section stays hidden. */
    async open() {
      root.hidden = false;
      try {
        await refresh();
      } catch (error) {
        problem.textContent = error.message;
      }
    },
  };
}

const day = (time) => new Date(time).toLocaleDateString();
