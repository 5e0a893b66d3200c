// Chooses the page by the address behind `#` and keeps one page alive at a time.

import { jobPage } from "./job.js";
import { listPage } from "./list.js";
import { loginPage, session } from "./login.js";

const main = document.getElementById("main");
const logout = document.getElementById("logout");
let leave = () => {};
let isLockedOut = false;

function route() {
  leave();
  main.replaceChildren();
  const job = location.hash.match(/^#\/jobs\/([0-9a-f-]+)$/);
  if (isLockedOut) leave = loginPage(main, enter);
  else leave = job ? jobPage(main, job[1]) : listPage(main);
}

/** Finds out whether this browser may look at anything. */
async function look() {
  try {
    const { needed, scopes } = await session();
    logout.hidden = scopes === null;
    return needed && scopes === null;
  } catch {
    // The server does not answer; the health line says so.
    return isLockedOut;
  }
}

async function enter() {
  isLockedOut = await look();
  route();
}

/** Sessions end while a page is open. */
async function stay() {
  const wasLockedOut = isLockedOut;
  isLockedOut = await look();
  if (isLockedOut !== wasLockedOut) route();
}

logout.addEventListener("click", async () => {
  await fetch("/logout", { method: "POST" });
  enter();
});

async function health() {
  const place = document.getElementById("health");
  try {
    const response = await fetch("/readyz");
    const { checks } = await response.json();
    const missing = checks.filter((check) => !check.ok);
    place.classList.toggle("bad", missing.length > 0);
    place.title = missing.map((check) => `${check.name}: ${check.detail} ${check.hint ?? ""}`).join("\n");
    place.textContent = missing.length === 0 ? "ready" : `not ready: ${missing.map((check) => check.name).join(", ")}`;
  } catch {
    place.classList.add("bad");
    place.textContent = "the server does not answer";
  }
}

addEventListener("hashchange", route);
enter();
health();
setInterval(() => { health(); stay(); }, 30000);
