// Chooses the page by the address behind `#` and keeps one page alive at a time.

import { jobPage } from "./job.js";
import { listPage } from "./list.js";
import { loginPage, session } from "./login.js";
import { link, openLink } from "./visitor.js";

const main = document.getElementById("main");
const logout = document.getElementById("logout");
let leave = () => {};
let isLockedOut = false;
// Who this browser is: `{ needed, scopes, job }`.
let who = { needed: false, scopes: null, job: null };

function route() {
  leave();
  main.replaceChildren();
  const job = location.hash.match(/^#\/jobs\/([0-9a-f-]+)$/);
  const shared = link(location.hash);
  if (shared) leave = openLink(main, shared, enter);
  else if (isLockedOut) leave = loginPage(main, enter);
  // Who came by a link sees its job wherever they go.
  else if (who.job) leave = jobPage(main, who.job, who);
  else leave = job ? jobPage(main, job[1], who) : listPage(main);
}

/** Finds out whether this browser may look at anything. */
async function look() {
  try {
    who = await session();
    logout.hidden = who.scopes === null;
    return who.needed && who.scopes === null;
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
  if (link(location.hash)) return;
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
