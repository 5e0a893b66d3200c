// Asks for a token if the server needs one. The token goes into a cookie hidden from scripts.

import { api, h } from "./dom.js";

/**
 * Whether a token is needed, and the scopes of this browser's.
 * @returns {Promise<import("fled-api").Session>}
 */
export const session = () => api("login");

/**
 * Whether a session may see the data of all users.
 * @param {import("fled-api").Session} who
 */
export const seesAll = ({ needed, scopes }) =>
  !needed || (scopes ?? "").split(",").includes("admin");

/** Shows the form; calls `done` once the token is accepted. */
export function loginPage(main, done) {
  const token = h("input", { type: "password", autocomplete: "current-password", required: true, size: 40 });
  const problem = h("p", { class: "problem", role: "alert" });
  const button = h("button", { class: "main", type: "submit" }, "Log in");
  async function submit(event) {
    event.preventDefault();
    button.disabled = true;
    problem.textContent = "";
    try {
      const body = JSON.stringify({ token: token.value });
      await api("login", { method: "POST", headers: { "Content-Type": "application/json" }, body });
      done();
    } catch (error) {
      problem.textContent = error.message;
    }
    button.disabled = false;
  }
  main.append(h("section", {},
    h("h2", {}, "This server requires a token"),
    h("form", { onsubmit: submit }, h("label", {}, "Token", token), button),
    h("p", { class: "hint" }, "The server's administrator creates tokens with ", h("code", {}, "fled token create"), ". This browser stays logged in for up to a week."),
    problem));
  token.focus();
  return () => {};
}
