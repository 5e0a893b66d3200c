// Modal questions, for example before something is lost.

import { h } from "./dom.js";

/** Shows a question; returns whether the answer is `yes`. */
export function ask(question, detail, yes, no = "Cancel") {
  const dialog = h("dialog", { "aria-label": question });
  const answer = (word) => () => dialog.close(word);
  dialog.append(
    h("h2", {}, question), detail ? h("p", {}, detail) : "",
    h("div", { class: "row" },
      // The harmless answer comes first and has the focus.
      h("button", { type: "button", autofocus: true, onclick: answer("no") }, no),
      h("button", { type: "button", class: "danger", onclick: answer("yes") }, yes)));
  return answered(dialog);
}

/**
 * Shows a dialog; returns whether it is closed with `yes`. Escape and leaving the page mean no.
 * @param {HTMLDialogElement} dialog
 * @returns {Promise<boolean>}
 */
export function answered(dialog) {
  const away = () => dialog.close("no");
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
