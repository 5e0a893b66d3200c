// Cameras and sparse points in 3D, shown once there are poses.

import assert from "node:assert/strict";
import { after, before } from "node:test";

import { drawn, picture } from "./browser.js";
import { Stand, both, part, seen } from "./played.js";
import { until } from "./until.js";

let stand;

before(async () => { stand = await Stand.start(); });
after(() => stand?.stop());

both("cameras and sparse points are shown before a scene is trained", async (width) => {
  const { server } = stand;
  const plan = { adapter: "deblur:1500" };
  const id = await server.submit(stand.folder, `points at ${width}`, plan);
  try {
    await stand.visit("points", `#/jobs/${id}`, async (page) => {
      const root = part(page, "Scene");
      await root.getByRole("button", { name: /^View cameras and points/ }).click();
      await seen(root.getByRole("status"), "400 sparse points, used to place the cameras.");
      await root.locator(".frame[aria-busy=false]").waitFor();
      const [points, lines] = [root.locator("canvas").first(), root.locator("canvas.lines")];
      await until("points are drawn", async () => (await drawn(points)) > 0.003);
      assert.ok((await drawn(lines)) > 0.002, "the cameras");
      assert.equal(await root.getByLabel("Cameras", { exact: true }).isChecked(), true);
      assert.equal(await root.getByRole("button", { name: /^Save PNG/ }).isVisible(), false);
      assert.equal(await root.getByRole("slider", { name: "round" }).isVisible(), false);
      await picture(page, `page-points-${width}`);
      await root.getByRole("button", { name: "Next photograph" }).click();
      await root.locator(".frame[aria-busy=false]").waitFor();
      await root.getByLabel("Cameras", { exact: true }).uncheck();
      await lines.waitFor({ state: "hidden" });
    }, width);
  } finally {
    await server.cancel(id);
  }
});
