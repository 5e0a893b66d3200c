// Files that earlier uploads of this browser left on the server, with a way to discard them.

import { begun } from "./begun.js";
import { api, count, h } from "../lib/dom.js";

const WORDS = {
  interrupted: (files) => `An interrupted upload left ${files} on the server, complete or in part. Choose the same files again to continue where it stopped.`,
  refused: (files) => `The server still has ${files} of an upload that it refused. Choose the same files again without those at fault, or with more photographs; nothing is sent twice.`,
};

/** A line for each kind of leftover. */
export function leftovers() {
  const left = begun.left();
  return Object.keys(WORDS).filter((kind) => left[kind].length > 0).map((kind) => line(kind, left[kind]));
}

function line(kind, ids) {
  const problem = h("span", { class: "bad", role: "alert" });
  const button = h("button", { type: "button", class: "small" }, "Discard");
  const root = h("p", { class: "hint leftover" }, WORDS[kind](count(ids.length, "file")), " ", button, " ", problem);
  button.addEventListener("click", async () => {
    button.disabled = true;
    problem.textContent = "";
    try {
      for (const id of ids) await discard(id);
      root.remove();
    } catch (error) {
      problem.textContent = error.message;
    }
    button.disabled = false;
  });
  return root;
}

async function discard(id) {
  try {
    await api(`v1/uploads/${id}`, { method: "DELETE", headers: { "Tus-Resumable": "1.0.0" } });
  } catch (error) {
    // The server has deleted it already, as requested.
    if (error.status !== 404) throw error;
  }
  begun.drop([id]);
}
