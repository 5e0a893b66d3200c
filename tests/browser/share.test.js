// Shares a job with a user without a token: one browser makes the link, another opens it.

import assert from "node:assert/strict";
import { once } from "node:events";
import { createServer } from "node:http";
import { after, before, test } from "node:test";

import { Browser, PHONE, drawn, loaded, overflowing, picture } from "./browser.js";
import { Server } from "./server.js";
import { until } from "./until.js";

let server;
let owner;
let id;

before(async () => {
  server = await Server.start(process.env.FLED);
  id = await server.sample();
  owner = await Browser.start(server.base);
});

after(async () => {
  await owner?.stop();
  await server?.stop();
});

const button = (page, name) => page.getByRole("button", { name, exact: true });

test("without tokens there are no links", async () => {
  await owner.visit("unshared", `#/jobs/${id}`, async (page) => {
    await page.getByRole("heading", { name: "Files", exact: true }).waitFor();
    assert.equal(await button(page, "Create link").count(), 0);
  });
});

test("another page shows only the scene in a frame", async () => {
  const token = server.token();
  const headers = { Authorization: `Bearer ${token}`, "Content-Type": "application/json" };
  const made = await fetch(`${server.base}/v1/jobs/${id}/shares`, { method: "POST", headers, body: '{"name":"a blog"}' });
  const share = await made.json();
  const source = share.path.replace("/#/share/", "/embed#");
  const html = (path) => `<!doctype html><title>blog</title><iframe src="${server.base}${path}" width="800" height="600"></iframe>`;
  const blog = createServer((request, response) => {
    response.setHeader("Content-Type", "text/html");
    response.end(html(request.url === "/" ? source : "/"));
  }).listen(0, "127.0.0.1");
  await once(blog, "listening");
  const context = await owner.chromium.newContext();
  try {
    const page = await context.newPage();
    const faults = [];
    page.on("pageerror", (error) => faults.push(error.message));
    // A different site for cookies.
    const address = `http://localhost:${blog.address().port}`;
    await page.goto(address);
    const frame = page.frameLocator("iframe");
    await until("its poster is there", () => loaded(frame.locator(".poster img")));
    await frame.getByRole("button", { name: "Walk through the scene" }).click();
    await frame.locator(".frame[aria-busy=false]").waitFor();
    await until("the scene is drawn", async () => (await drawn(frame.locator(".frame canvas").first())) > 0.05);
    await frame.getByRole("button", { name: "Reset to the first view" }).waitFor();
    await picture(page, "embedded");
    await page.goto(`${address}/page`);
    assert.equal(await page.frameLocator("iframe").getByRole("banner").count(), 0, "the page itself is not framed");
    await fetch(`${server.base}/v1/jobs/${id}/shares/${share.id}`, { method: "DELETE", headers });
    await page.goto(address);
    await frame.getByText("This link does not work").waitFor();
    assert.deepEqual(faults, []);
  } finally {
    await context.close();
    blog.close();
  }
});

test("a link opens only its job, until it is revoked", async () => {
  const token = server.token();
  await owner.visit("sharing", `#/jobs/${id}`, async (page) => {
    await page.getByLabel("Token").fill(token);
    await button(page, "Log in").click();
    await page.getByLabel("Name", { exact: true }).fill("Anna");
    await button(page, "Create link").click();
    const link = await page.getByLabel("Link", { exact: true }).inputValue();
    assert.match(await page.getByLabel("Embed", { exact: true }).inputValue(), /src="http[^"]+\/embed#[0-9a-f-]{36}\/fled_[0-9a-f]{64}"/);
    assert.match(link, /#\/share\/[0-9a-f-]{36}\/fled_[0-9a-f]{64}$/);
    await page.getByText("not used yet").waitFor();
    assert.deepEqual(await overflowing(page), []);
    await owner.visit("shared", link.slice(server.base.length + 1), async (visitor) => {
      await visitor.getByRole("heading", { name: "Sample: a dark room" }).waitFor();
      await visitor.getByRole("heading", { name: "Files", exact: true }).waitFor();
      assert.ok(!visitor.url().includes("fled_"), "the secret leaves the address");
      for (const name of ["Delete", "Try again", "Create link"]) assert.equal(await button(visitor, name).count(), 0, name);
      assert.equal(await visitor.getByRole("heading", { name: "Log", exact: true }).count(), 0);
      assert.deepEqual(await overflowing(visitor), []);
      await visitor.getByRole("button", { name: "Walk through the scene" }).click();
      await visitor.locator(".frame[aria-busy=false]").waitFor();
      // Every address shows this job.
      await visitor.goto(`${server.base}/#/`);
      await visitor.getByRole("heading", { name: "Sample: a dark room" }).waitFor();
      // The browser loads a strip of pictures once it comes near.
      await visitor.getByRole("group", { name: "Pictures of the view" }).scrollIntoViewIfNeeded();
      await until("its pictures are there", () => loaded(visitor.locator("img[src]")));
    }, PHONE);
    await page.reload();
    await page.getByText(/· last used /).waitFor();
    await button(page, "Revoke Anna").click();
    await button(page, "Revoke Anna").waitFor({ state: "detached" });
    const opened = async () => (await fetch(`${server.base}/v1/jobs/${id}`, {
      headers: { Authorization: `Bearer ${link.split("/").pop()}` } })).status;
    await until("the link opens nothing", async () => (await opened()) === 401);
    await owner.visit("ended link", link.slice(server.base.length + 1), async (visitor, faults) => {
      await visitor.getByText("This link does not work").waitFor();
      assert.deepEqual(await overflowing(visitor), []);
      // The browser itself also reports each refusal.
      for (const fault of faults.splice(0)) assert.match(fault, /\b401\b/);
    });
  });
});
