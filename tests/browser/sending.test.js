// Uploads that the connection, a reload or the user interrupts.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Browser, picture } from "./browser.js";
import { Stand, button, provoked, seen } from "./played.js";
import { Proxy } from "./proxy.js";
import { until } from "./until.js";

const PIECES = "**/v1/uploads/*";

let stand;

before(async () => {
  stand = await Stand.start();
});

after(() => stand?.stop());

/** Chooses the photographs and a plan that succeeds, and presses Start. */
async function start(page) {
  await page.getByLabel("Choose a folder").setInputFiles(stand.folder);
  await page.getByText("files chosen").waitFor();
  await button(page, "Start").click();
}

/** Records every request about uploads from now on: `METHOD path`. */
function requests(page) {
  const list = [];
  page.on("request", (request) => {
    const { pathname } = new URL(request.url());
    if (pathname.startsWith("/v1/uploads")) list.push(`${request.method()} ${pathname}`);
  });
  return list;
}

const of = (list, method) => list.filter((line) => line.startsWith(`${method} `));

/** Waits for a job's page. */
const arrived = (page) => page.waitForURL(/#\/jobs\/[0-9a-f-]{36}$/);

/** Checks that the page logged only a lost connection. */
function lost(faults) {
  for (const fault of faults.splice(0)) assert.match(fault, /ERR_(CONNECTION|FAILED|ABORTED)/);
}

test("an upload resumes by itself after a lost connection", () =>
  stand.visit("sending-broken", "", async (page, faults) => {
    const asked = requests(page);
    let broken = 0;
    await page.route(PIECES, (route) => {
      const breaks = route.request().method() === "PATCH" && broken < 4;
      if (!breaks) return route.continue();
      broken += 1;
      return route.abort("connectionreset");
    });
    await start(page);
    await seen(page.locator("[role=status]"), "Connection lost");
    await arrived(page);
    assert.equal(broken, 4);
    const files = of(asked, "POST").length;
    assert.ok(files >= 8, "every file was begun once");
    assert.equal(new Set(of(asked, "PATCH")).size, files);
    assert.equal(await page.evaluate("localStorage.getItem('fled uploads')"), "{}");
    lost(faults);
  }));

test("after a reload the same files resume", () =>
  stand.visit("sending-reloaded", "", async (page, faults) => {
    const asked = requests(page);
    let through = 0;
    const broken = new Set();
    await page.route(PIECES, (route) => {
      if (route.request().method() !== "PATCH") return route.continue();
      through += 1;
      if (through <= 3) return route.continue();
      broken.add(route.request().url());
      return route.abort("connectionreset");
    });
    await start(page);
    await seen(page.locator("[role=status]"), "Connection lost");
    // Three files are sent at once: once all three are interrupted, no answer is pending that the
    // reload would lose.
    await until("all three are broken off", () => broken.size === 3);
    await page.unroute(PIECES);
    await page.reload();
    await page.getByText("An interrupted upload").waitFor();
    lost(faults);
    const first = asked.splice(0);
    await start(page);
    await arrived(page);
    const [begun, later] = [of(first, "POST").length, of(asked, "POST").length];
    assert.ok(begun >= 4 && begun + later === new Set([...of(first, "PATCH"), ...of(asked, "PATCH")]).size, `${begun} and ${later}`);
    const done = of(first, "PATCH").slice(0, 3);
    for (const path of done) assert.ok(!asked.includes(path), `${path} was sent twice`);
  }));

test("an upload can be cancelled, and Start resumes it", () =>
  stand.visit("sending-cancelled", "", async (page) => {
    const asked = requests(page);
    const pieces = () => of(asked, "PATCH");
    // Three files are sent at once; the second three never arrive at the server.
    await page.route(PIECES, (route) =>
      route.request().method() === "PATCH" && pieces().length > 3 ? null : route.continue());
    await start(page);
    await until("three pieces hang", () => pieces().length === 6);
    await seen(page.locator("form [role=status]"), /^Uploading: \d+ %, 3 of \d+ files/);
    await picture(page, "page-sending");
    await button(page, "Cancel").click();
    await page.getByText("Upload cancelled. Start continues where it stopped.").waitFor();
    assert.equal(await button(page, "Cancel").isVisible(), false);
    await page.unroute(PIECES);
    const done = pieces().slice(0, 3);
    const before = asked.length;
    await button(page, "Start").click();
    await arrived(page);
    for (const path of done) assert.ok(!asked.slice(before).includes(path), `${path} was sent twice`);
    assert.equal(of(asked, "POST").length, new Set(pieces()).size, "every file was begun once");
  }, "phone"));

test("photographs are not sent while there is no room for their job", () =>
  stand.visit("sending-no-room", "", async (page, faults) => {
    const asked = requests(page);
    const problem = { status: 429, code: "quota_jobs", detail: "At most 1 of your jobs may wait or run at a time." };
    await page.route("**/v1/uploads", (route) =>
      route.fulfill({ status: 429, contentType: "application/problem+json", headers: { "Retry-After": "60" }, body: JSON.stringify(problem) }));
    await start(page);
    await seen(page.getByRole("alert"), problem.detail);
    await until("it can be tried again", () => button(page, "Start").isEnabled());
    assert.deepEqual(of(asked, "PATCH"), []);
    provoked(faults, "429");
  }));

/** Starts a photograph of some megabytes, through a proxy that refuses larger bodies. */
async function throughProxy(name, largest, judge) {
  const proxy = await Proxy.start(stand.server.base, "", largest);
  const browser = new Browser(proxy.base, stand.browser.chromium);
  browser.isReady = true;
  try {
    await browser.visit(name, "", async (page, faults) => {
      const large = { name: "large.jpg", mimeType: "image/jpeg", buffer: Buffer.alloc(5 << 20, 7) };
      await page.getByLabel("Choose files").setInputFiles(large);
      await page.getByText("1 file chosen").waitFor();
      await button(page, "Start").click();
      await judge(page, proxy.refused);
      provoked(faults, "4(13|22)");
    });
  } finally {
    await proxy.stop();
  }
}

test("pieces shrink until a proxy lets them pass", () =>
  throughProxy("sending-shrunk", 1 << 20, async (page, refused) => {
    // The server has received all of it, and says what is wrong with it.
    await seen(page.getByRole("alert"), "large.jpg");
    assert.deepEqual(refused, [5 << 20, 2.5 * (1 << 20), 1.25 * (1 << 20)]);
  }));

test("a proxy that refuses the smallest pieces is named", () =>
  throughProxy("sending-refused", 100_000, async (page, refused) => {
    await seen(page.getByRole("alert"), "A proxy in front of the server refuses even pieces of 512 KiB");
    assert.equal(refused.at(-1), 512 << 10);
  }));

test("the sample opens at once where a job of it with these options has finished", async () => {
  const { base } = stand.server;
  const { capture_id } = await stand.server.job(await stand.finished());
  const finished = async (options) => {
    const body = { capture_id, name: "Sample: a dark room", preset: "preview", options: { adapter: "ok", ...options } };
    const headers = { "Content-Type": "application/json" };
    const reply = await fetch(`${base}/v1/jobs`, { method: "POST", headers, body: JSON.stringify(body) });
    const { id } = await reply.json();
    await stand.server.reached(id, "succeeded");
    return id;
  };
  const id = await finished({});
  // A newer one that took less time.
  await finished({ steps: 40 });
  await stand.visit("sample-ready", "", async (page) => {
    const made = [];
    page.on("request", (request) => { if (request.method() === "POST") made.push(request.url()); });
    await page.getByText("a dark room").first().waitFor();
    await page.getByLabel("Preset").first().selectOption("preview");
    await button(page, "Try a sample").click();
    await arrived(page);
    assert.ok(page.url().endsWith(id), page.url());
    assert.deepEqual(made, []);
  });
});

test("the sample that ships opens finished, and is made once", () =>
  stand.visit("sample-shipped", "", async (page) => {
    const made = [];
    page.on("request", (request) => { if (request.method() === "POST") made.push(new URL(request.url()).pathname); });
    const times = () => page.getByText("Recent auto jobs took").textContent();
    const before = await times();
    for (const _ of ["made", "found"]) {
      // The form knows the finished jobs.
      await times();
      await button(page, "Try a sample").click();
      await arrived(page);
      await page.getByRole("heading", { level: 1, name: "Sample: a dark room" }).waitFor();
      await page.getByText("better than brightening alone").waitFor();
      await page.getByText("ships with the server").waitFor();
      await page.getByRole("link", { name: "Jobs" }).click();
      await page.getByText("a dark room").first().waitFor();
    }
    assert.deepEqual(made, ["/v1/captures/sample"]);
    // It took no time here, so it tells nothing about other jobs.
    assert.equal(await times(), before);
  }));
