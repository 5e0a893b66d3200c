// A job is shown to somebody without a token: one browser makes the link, another opens it.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Browser, PHONE, loaded, overflowing } from "./browser.js";
import { Server } from "./server.js";
import { until } from "./until.js";

let server;
let owner;
let id;

before(async () => {
  server = await Server.start(process.env.FLED);
  id = await server.submit(server.capture(), "for others");
  await server.reached(id, "succeeded");
  owner = await Browser.start(server.base);
});

after(async () => {
  await owner?.stop();
  await server?.stop();
});

const button = (page, name) => page.getByRole("button", { name, exact: true });

test("without tokens there is nothing to share", async () => {
  await owner.visit("unshared", `#/jobs/${id}`, async (page) => {
    await page.getByRole("heading", { name: "Files", exact: true }).waitFor();
    assert.equal(await button(page, "Create link").count(), 0);
  });
});

test("a link opens its job alone, until it is ended", async () => {
  const token = server.token();
  await owner.visit("sharing", `#/jobs/${id}`, async (page) => {
    await page.getByLabel("Token").fill(token);
    await button(page, "Log in").click();
    await page.getByLabel("Name").fill("Anna");
    await button(page, "Create link").click();
    const link = await page.getByLabel("Link", { exact: true }).inputValue();
    assert.match(link, /#\/share\/[0-9a-f-]{36}\/fled_[0-9a-f]{64}$/);
    await page.getByText("not used yet").waitFor();
    assert.deepEqual(await overflowing(page), []);
    await owner.visit("shared", link.slice(server.base.length + 1), async (visitor) => {
      await visitor.getByRole("heading", { name: "for others" }).waitFor();
      await visitor.getByRole("heading", { name: "Files", exact: true }).waitFor();
      assert.ok(!visitor.url().includes("fled_"), "the secret leaves the address");
      for (const name of ["Delete", "Try again", "Create link"]) assert.equal(await button(visitor, name).count(), 0, name);
      assert.equal(await visitor.getByRole("heading", { name: "Log", exact: true }).count(), 0);
      assert.deepEqual(await overflowing(visitor), []);
      await visitor.getByRole("button", { name: "Walk through the scene" }).click();
      await visitor.locator(".frame[aria-busy=false]").waitFor();
      // Wherever they go, they are at this job.
      await visitor.goto(`${server.base}/#/`);
      await visitor.getByRole("heading", { name: "for others" }).waitFor();
      // A browser fetches a strip of pictures once it comes near.
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
      // Each refusal is reported by the browser itself, too.
      for (const fault of faults.splice(0)) assert.match(fault, /\b401\b/);
    });
  });
});
