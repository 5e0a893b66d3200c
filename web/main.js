// Chooses the page by the address behind `#` and keeps one page alive at a time.

import { jobPage } from "./job.js";
import { listPage } from "./list.js";

const main = document.getElementById("main");
let leave = () => {};

function route() {
  leave();
  main.replaceChildren();
  const job = location.hash.match(/^#\/jobs\/([0-9a-f-]+)$/);
  leave = job ? jobPage(main, job[1]) : listPage(main);
}

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
route();
health();
setInterval(health, 30000);
