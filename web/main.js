// Chooses the page by the address after `#` and keeps one page alive at a time. The list of jobs
// opens first; the modules of another page load when it is opened, or about to be.

import { nothing } from "./lib/dom.js";
import { listPage } from "./pages/list.js";
import { areWorkers, readiness } from "./lib/machine.js";
import { loginPage, seesAll, session } from "./lib/login.js";
import { preload } from "./lib/modules.js";
import { shareOf } from "./lib/place.js";

const main = document.getElementById("main");
const logout = document.getElementById("logout");
const pages = document.getElementById("pages");
const workers = document.getElementById("workers");
const none = () => {};
let leave = none;
/** Pages opened so far; a result loaded for an earlier one is not shown. */
let opened = 0;
let isLockedOut = false;
/**
 * This browser's session.
 * @type {import("fled-api").Session}
 */
let who = { needed: false, scopes: null, job: null };

/**
 * A page: shows itself, given the parts of the address, and returns a function that ends it.
 * @typedef {(main: HTMLElement, ...found: string[]) => () => void} Page
 */

/** @type {() => Promise<Page>} */
const loadList = async () => listPage;
/** @type {() => Promise<Page>} */
async function loadJob() {
  const { jobPage } = await import("./job/job.js");
  return (main, id) => jobPage(main, who, id);
}
/** @type {(shared: [string, string]) => () => Promise<Page>} */
const loadVisitor = (shared) => async () => {
  const { openLink } = await import("./pages/visitor.js");
  return (main) => openLink(main, shared, enter);
};
/** @type {() => Promise<Page>} */
const loadCapture = async () => (await import("./pages/capture.js")).capturePage;

/**
 * Pages by address: the loader of each, and the module of its page. Captured groups go to the page.
 * @type {[RegExp, () => Promise<Page>, string?][]}
 */
const ROUTES = [
  [/^(?:#?\/?)$/, loadList],
  [/^#\/jobs\/([^/]+)$/, loadJob, "job/job.js"],
  [/^#\/compare\/([^/]*)$/, async () => (await import("./compare/compare.js")).comparePage, "compare/compare.js"],
  [/^#\/captures$/, async () => (await import("./pages/captures.js")).capturesPage, "pages/captures.js"],
  [/^#\/captures\/([^/]+)$/, loadCapture, "pages/capture.js"],
  [/^#\/captures\/([^/]+)\/from\/([^/]+)$/, loadCapture, "pages/capture.js"],
  [/^#\/workers$/, async () => {
    const { workersPage } = await import("./pages/workers.js");
    return (main) => workersPage(main, who);
  }, "pages/workers.js"],
  [/^#\/api$/, async () => (await import("./pages/reference.js")).referencePage, "pages/reference.js"],
];

function route() {
  leave();
  leave = none;
  opened += 1;
  main.replaceChildren();
  document.title = "fled";
  const part = ["#/captures", "#/workers", "#/api"].find((page) => location.hash.startsWith(page)) ?? "#/";
  pages.hidden = isLockedOut || who.job !== null;
  for (const tab of pages.querySelectorAll("a")) {
    const here = tab.hash === part;
    if (here) tab.setAttribute("aria-current", "page");
    else tab.removeAttribute("aria-current");
  }
  const shared = shareOf(location.hash);
  if (shared) {
    show(loadVisitor(shared), "pages/visitor.js", []);
  } else if (isLockedOut && location.hash !== "#/api") {
    leave = loginPage(main, enter);
  } else if (who.job !== null && location.hash !== "#/api") {
    // A visitor by a link to a job sees that job at every address.
    show(loadJob, "job/job.js", [who.job]);
  } else {
    // The part after `?` belongs to the page.
    const [path] = location.hash.split("?");
    const [pattern, load, module] = ROUTES.find(([pattern]) => pattern.test(path)) ?? [];
    if (load) show(load, module, path.match(pattern).slice(1));
    else nothing(main, "Page not found.");
  }
}

/**
 * @param {() => Promise<Page>} load
 * @param {string | undefined} module
 * @param {string[]} found
 */
async function show(load, module, found) {
  const mine = opened;
  if (module) preload(module);
  let page;
  try {
    page = await load();
  } catch {
    const again = "The server did not send this page. Reload once it responds again.";
    if (mine === opened) nothing(main, again);
    return;
  }
  if (mine === opened) leave = page(main, ...found);
}

/** Fetches the modules of a page whose link a pointer or the focus has reached. */
function expect(event) {
  const target = /** @type {Element} */ (event.target).closest?.("a[href^='#/']");
  const [path] = target?.getAttribute("href").split("?") ?? [""];
  const [, , module] = (target && ROUTES.find(([pattern]) => pattern.test(path))) ?? [];
  if (module) preload(module);
}

/** Finds out whether this browser may see anything. */
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

/** Links the page of workers if there are any and the session may see them. */
async function linkWorkers() {
  const asking = who;
  try {
    const isShown = seesAll(asking) && (await areWorkers());
    if (asking === who) workers.hidden = !isShown;
  } catch {
    // The server does not answer; the health line says so.
  }
}

/** Checks the session, which may end, or change in another tab, while a page is open. */
async function stay() {
  if (shareOf(location.hash)) return;
  const before = `${isLockedOut} ${who.scopes} ${who.job}`;
  isLockedOut = await look();
  if (`${isLockedOut} ${who.scopes} ${who.job}` !== before) route();
  linkWorkers();
}

logout.addEventListener("click", async () => {
  await fetch("logout", { method: "POST" });
  enter();
});

/** Interval and timeout of the server check, so that an outage shows within 5 s. */
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
    await fetch("livez", { signal: AbortSignal.timeout(ALIVE_MS) });
    if (!isThere) health();
  } catch {
    gone();
  }
}

async function health() {
  try {
    const { checks, ready } = await readiness();
    isThere = true;
    const missing = checks.filter((check) => !check.ok);
    place.classList.toggle("bad", missing.length > 0);
    place.title = missing.map((check) => `${check.name}: ${check.detail} ${check.hint ?? ""}`).join("\n").replaceAll("`", "");
    const names = missing.map((check) => check.name).join(", ");
    // A server without a worker is ready: it accepts jobs, which wait.
    if (missing.length === 0) place.textContent = "Ready";
    else place.textContent = ready ? "No worker" : `Not ready: ${names}`;
  } catch {
    gone();
  }
}

// Without this, a file dropped outside a form would replace the page.
for (const name of /** @type {const} */ (["dragover", "drop"])) {
  addEventListener(name, (event) => {
    if (event.defaultPrevented || !event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    event.dataTransfer.dropEffect = "none";
  });
}
for (const name of ["pointerover", "focusin"]) addEventListener(name, expect);
addEventListener("hashchange", route);
enter();
health();
addEventListener("unanswered", gone);
setInterval(alive, ALIVE_MS);
setInterval(() => { health(); stay(); }, 30000);
