// The dashboard and the API below the path of a proxy that removes it.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Browser, loaded } from "./browser.js";
import { Stand, button, seen, state } from "./played.js";
import { Proxy } from "./proxy.js";
import { until } from "./until.js";

let stand;
let proxy;
let browser;

before(async () => {
  stand = await Stand.start();
  proxy = await Proxy.start(stand.server.base, "/fled");
  browser = new Browser(proxy.base, stand.browser.chromium);
  browser.isReady = true;
});

after(async () => {
  await proxy?.stop();
  await stand?.stop();
});

/** Waits for the page of a job that has succeeded, with its pictures. */
async function finished(page) {
  await seen(state(page), "succeeded");
  await page.getByRole("group", { name: "Pictures of the view" }).scrollIntoViewIfNeeded();
  await until("its pictures are there", () => loaded(page.locator("img[src]")));
}

test("every page works below a path", () => browser.visit("below", "", async (page) => {
  await page.getByLabel("Choose a folder").setInputFiles(stand.folder);
  await page.getByText("files chosen").waitFor();
  await button(page, "Start").click();
  await page.waitForURL(/\/fled\/#\/jobs\/[0-9a-f-]{36}$/);
  await finished(page);
  for (const [tab, title] of [["Captures", "Captures"], ["API", "API"]]) {
    await page.getByRole("navigation").getByRole("link", { name: tab, exact: true }).click();
    await page.getByRole("heading", { name: title, exact: true, level: 1 }).waitFor();
  }
  const missing = await page.request.get(`${proxy.base}/no/such/page`, { headers: { Accept: "text/html" } });
  assert.equal(missing.status(), 404);
  assert.deepEqual(proxy.outside, []);
}));

test("a page at a wrong address leads to the list", async () => {
  const context = await browser.chromium.newContext();
  const page = await context.newPage();
  const answer = await page.goto(`${proxy.base}/no/such/page`);
  assert.equal(answer.status(), 404);
  await until("its picture is there", () => loaded(page.locator("img")));
  await page.getByRole("link", { name: "All jobs" }).click();
  await button(page, "Try a sample").waitFor();
  assert.equal(page.url(), `${proxy.base}/`);
  assert.deepEqual(proxy.outside, []);
  await context.close();
});

test("an upload's address holds below a path", async () => {
  const made = await fetch(`${proxy.base}/v1/uploads`, {
    method: "POST",
    headers: { "Tus-Resumable": "1.0.0", "Upload-Length": "3", "Upload-Metadata": "filename YS56aXA=" },
  });
  const address = new URL(made.headers.get("Location"), made.url).href;
  assert.ok(address.startsWith(`${proxy.base}/v1/uploads/`), address);
  const headers = { "Tus-Resumable": "1.0.0" };
  assert.equal((await fetch(address, { method: "HEAD", headers })).status, 200);
  assert.equal((await fetch(address, { method: "DELETE", headers })).status, 204);
});

test("sessions, links and frames stay below the path", async () => {
  const id = await stand.finished();
  const token = stand.server.token();
  await browser.visit("below-shared", `#/jobs/${id}`, async (page) => {
    await page.getByLabel("Token").fill(token);
    await button(page, "Log in").click();
    await button(page, "Create link").click();
    const link = await page.getByLabel("Link", { exact: true }).inputValue();
    assert.ok(link.startsWith(`${proxy.base}/#/share/${id}/fled_`), link);
    const frame = await page.getByLabel("Embed", { exact: true }).inputValue();
    const [, source] = frame.match(/src="([^"]+)"/);
    assert.ok(source.startsWith(`${proxy.base}/embed#${id}/fled_`), source);
    const [session] = await page.context().cookies();
    assert.equal(session.path, "/fled", "other services of the proxy do not receive it");
    await browser.visit("below-visitor", link.slice(proxy.base.length + 1), finished);
    await browser.visit("below-frame", source.slice(proxy.base.length + 1), (embedded) =>
      until("its poster is there", () => loaded(embedded.locator(".poster img"))));
    await page.goto("about:blank");
    await page.context().request.post(`${proxy.base}/logout`);
    assert.deepEqual(await page.context().cookies(), [], "logging out removes it");
  });
  assert.deepEqual(proxy.outside, []);
});
