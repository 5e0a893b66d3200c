// Chooses the page by the address behind `#` and keeps one page alive at a time.

import { capturePage } from "./capture.js";
import { capturesPage } from "./captures.js";
import { nothing } from "./dom.js";
import { jobPage } from "./job.js";
import { listPage } from "./list.js";
import { loginPage, session } from "./login.js";

const main = document.getElementById("main");
const logout = document.getElementById("logout");
const pages = document.getElementById("pages");
let leave = () => {};
let isLockedOut = false;

/** Pages by address; what is in brackets goes to the page. */
const ROUTES = [
  [/^(?:#?\/?)$/, listPage],
  [/^#\/jobs\/([^/]+)$/, jobPage],
  [/^#\/captures$/, capturesPage],
  [/^#\/captures\/([^/]+)$/, capturePage],
  [/^#\/captures\/([^/]+)\/from\/([^/]+)$/, capturePage],
];

function route() {
  leave();
  leave = () => {};
  main.replaceChildren();
  document.title = "fled";
  pages.hidden = isLockedOut;
  for (const link of pages.children) {
    const here = link.hash === (location.hash.startsWith("#/captures") ? "#/captures" : "#/");
    if (here) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  if (isLockedOut) {
    leave = loginPage(main, enter);
    return;
  }
  for (const [pattern, page] of ROUTES) {
    const found = location.hash.match(pattern);
    if (found) {
      leave = page(main, ...found.slice(1));
      return;
    }
  }
  nothing(main, "There is no such page.");
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

// A file that is dropped where no page takes it would be opened in the page's place.
for (const name of ["dragover", "drop"]) {
  addEventListener(name, (event) => {
    if (event.defaultPrevented || !event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    event.dataTransfer.dropEffect = "none";
  });
}
addEventListener("hashchange", route);
enter();
health();
setInterval(() => { health(); stay(); }, 30000);
