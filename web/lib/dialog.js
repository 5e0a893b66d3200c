// Asks before something is lost.

import { h } from "./dom.js";

/** Shows a question; whether the answer is `yes`. Escape and another page are no. */
export function ask(question, detail, yes, no = "Cancel") {
  const dialog = h("dialog", { "aria-label": question });
  const answer = (word) => () => dialog.close(word);
  const away = answer("no");
  dialog.append(
    h("h2", {}, question), detail ? h("p", {}, detail) : "",
    h("div", { class: "row" },
      // The harmless answer comes first and has the focus.
      h("button", { type: "button", autofocus: true, onclick: answer("no") }, no),
      h("button", { type: "button", class: "danger", onclick: answer("yes") }, yes)));
  addEventListener("hashchange", away);
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      removeEventListener("hashchange", away);
      dialog.remove();
      resolve(dialog.returnValue === "yes");
    });
  });
}
