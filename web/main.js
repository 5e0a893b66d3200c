// Chooses the page by the address behind `#` and keeps one page alive at a time.

import { capturePage } from "./pages/capture.js";
import { capturesPage } from "./pages/captures.js";
import { comparePage } from "./compare/compare.js";
import { nothing } from "./lib/dom.js";
import { jobPage } from "./job/job.js";
import { listPage } from "./pages/list.js";
import { readiness } from "./lib/machine.js";
import { loginPage, seesAll, session } from "./lib/login.js";
import { referencePage } from "./pages/reference.js";
import { link, openLink } from "./pages/visitor.js";
import { areWorkers, workersPage } from "./pages/workers.js";

const main = document.getElementById("main");
const logout = document.getElementById("logout");
const pages = document.getElementById("pages");
const workers = document.getElementById("workers");
const none = () => {};
let leave = none;
let isLockedOut = false;
/**
 * This browser's session.
 * @type {import("fled-api").Session}
 */
let who = { needed: false, scopes: null, job: null };

/**
 * Pages by address; what is in brackets goes to the page.
 * @type {[RegExp, (main: HTMLElement, ...found: string[]) => () => void][]}
 */
const ROUTES = [
  [/^(?:#?\/?)$/, listPage],
  [/^#\/jobs\/([^/]+)$/, (main, id) => jobPage(main, who, id)],
  [/^#\/compare\/([^/]*)$/, comparePage],
  [/^#\/captures$/, capturesPage],
  [/^#\/captures\/([^/]+)$/, capturePage],
  [/^#\/captures\/([^/]+)\/from\/([^/]+)$/, capturePage],
  [/^#\/workers$/, (main) => workersPage(main, who)],
  [/^#\/api$/, referencePage],
];

function route() {
  leave();
  leave = none;
  main.replaceChildren();
  document.title = "fled";
  const part = ["#/captures", "#/workers", "#/api"].find((page) => location.hash.startsWith(page)) ?? "#/";
  pages.hidden = isLockedOut || who.job !== null;
  for (const tab of pages.querySelectorAll("a")) {
    const here = tab.hash === part;
    if (here) tab.setAttribute("aria-current", "page");
    else tab.removeAttribute("aria-current");
  }
  leave = special() ?? leave;
  if (leave !== none) return;
  // The part behind `?` is the page's own.
  const [path] = location.hash.split("?");
  for (const [pattern, page] of ROUTES) {
    const found = path.match(pattern);
    if (found) {
      leave = page(main, ...found.slice(1));
      return;
    }
  }
  nothing(main, "Page not found.");
}

/** The page that is shown whatever the address, where there is one. */
function special() {
  const shared = link(location.hash);
  if (shared) return openLink(main, shared, enter);
  if (location.hash === "#/api") return null;
  if (isLockedOut) return loginPage(main, enter);
  // A visitor by a link to a job sees that job at every address.
  return who.job === null ? null : jobPage(main, who, who.job);
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
  linkWorkers();
}

/** The workers' page has a link where there are any, for those who may see them. */
async function linkWorkers() {
  const asking = who;
  try {
    const isShown = seesAll(asking) && (await areWorkers());
    if (asking === who) workers.hidden = !isShown;
  } catch {
    // The server does not answer; the health line says so.
  }
}

/** Sessions end, and become others in another tab, while a page is open. */
async function stay() {
  if (link(location.hash)) return;
  const before = `${isLockedOut} ${who.scopes} ${who.job}`;
  isLockedOut = await look();
  if (`${isLockedOut} ${who.scopes} ${who.job}` !== before) route();
  linkWorkers();
}

logout.addEventListener("click", async () => {
  await fetch("/logout", { method: "POST" });
  enter();
});

/** So often the page looks whether the server is there, and waits so long: it says so within 5 s. */
const ALIVE_MS = 2400;
const place = document.getElementById("health");
let isThere = true;

function gone() {
  isThere = false;
  place.classList.add("bad");
  place.title = "";
  place.textContent = "Server not responding";
}

async function alive() {
  if (document.hidden) return;
  try {
    await fetch("/livez", { signal: AbortSignal.timeout(ALIVE_MS) });
    if (!isThere) health();
  } catch {
    gone();
  }
}

async function health() {
  try {
    const { checks } = await readiness();
    isThere = true;
    const missing = checks.filter((check) => !check.ok);
    place.classList.toggle("bad", missing.length > 0);
    place.title = missing.map((check) => `${check.name}: ${check.detail} ${check.hint ?? ""}`).join("\n");
    place.textContent = missing.length === 0 ? "Ready" : `Not ready: ${missing.map((check) => check.name).join(", ")}`;
  } catch {
    gone();
  }
}

// A file that is dropped where no page takes it would be opened in the page's place.
for (const name of /** @type {const} */ (["dragover", "drop"])) {
  addEventListener(name, (event) => {
    if (event.defaultPrevented || !event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    event.dataTransfer.dropEffect = "none";
  });
}
addEventListener("hashchange", route);
enter();
health();
addEventListener("unanswered", gone);
setInterval(alive, ALIVE_MS);
setInterval(() => { health(); stay(); }, 30000);
