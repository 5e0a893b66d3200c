// A page in headless Chromium with packages from npm and files, for programs that need a browser.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";

/**
 * Opens a page whose modules find `imports` (names and their places under node_modules in `packages`) and which has run
 * `script`; it fetches a file as `/files/PATH`. `use(page)` gets it. Errors in the page are errors here.
 */
export async function inBrowser(packages, imports, script, use) {
  const { chromium } = createRequire(`${packages}/`)("playwright-core");
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium-headless-shell",
    args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
  const page = await browser.newPage();
  const faults = [];
  page.on("pageerror", (error) => faults.push(error.message));
  const places = Object.fromEntries(Object.entries(imports).map(([name, place]) => [name, `/packages/${place}`]));
  const html = `<!doctype html><style>body { margin: 0 }</style>
<script type="importmap">${JSON.stringify({ imports: places })}</script>
<script type="module">${script}; window.isReady = true;</script>`;
  await page.route("**/*", (route) => {
    const { pathname } = new URL(route.request().url());
    if (pathname === "/") return route.fulfill({ body: html, contentType: "text/html" });
    const [, kind, place] = /^\/(files|packages)\/(.*)$/.exec(decodeURIComponent(pathname)) ?? [];
    if (kind === "files") return route.fulfill({ body: readFileSync(place) });
    if (kind !== "packages") return route.fulfill({ status: 404 });
    return route.fulfill({ body: readFileSync(join(packages, "node_modules", place)), contentType: "text/javascript" });
  });
  try {
    await page.goto("http://judge.test/");
    await page.waitForFunction("window.isReady").catch((error) => faults.push(error.message));
    if (faults.length === 0) await use(page);
    if (faults.length > 0) throw new Error(faults.join("\n"));
  } finally {
    await browser.close();
  }
}
