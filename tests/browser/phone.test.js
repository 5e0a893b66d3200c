// A finished job on a phone: the important parts first, the rest folded away but reachable.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { PHONE, overflowing } from "./browser.js";
import { Stand, part, seen, state } from "./played.js";
import { until } from "./until.js";

/** Length of the page, px: little more than four screens. */
const LENGTH = 3150;

let stand;

before(async () => {
  stand = await Stand.start();
});

after(() => stand?.stop());

test("a finished job takes a few screens of a phone, the important parts first", async () => {
  const id = await stand.finished();
  await stand.browser.visit(
    "phone-length",
    `#/jobs/${id}`,
    async (page) => {
      await page.locator(".summary").waitFor();
      await seen(part(page, "Log").locator(".gist"), /\d+ lines/);
      await until("it is as long as it gets", async () => {
        const length = () => page.evaluate(() => document.documentElement.scrollHeight);
        const before = await length();
        await page.waitForTimeout(500);
        return before === (await length());
      });
      const length = await page.evaluate(() => document.documentElement.scrollHeight);
      assert.ok(length < LENGTH, `${length} px`);
      const top = async (locator) => (await locator.boundingBox()).y;
      const order = [
        state(page),
        page.locator(".judged"),
        part(page, "Views").getByRole("slider"),
        part(page, "Scene").getByRole("button"),
        part(page, "Scores by view"),
        part(page, "Metrics by round").locator("svg").first(),
        page.getByRole("link", { name: "scene.ply", exact: true }),
        part(page, "Time by stage"),
      ];
      const tops = [];
      for (const one of order) tops.push(await top(one));
      assert.deepEqual(
        tops,
        [...tops].sort((a, b) => a - b),
        "in this order",
      );
      assert.ok(tops[1] < PHONE.height / 2, "the verdict is on the first screen");
      // A press unfolds the rest.
      for (const [title, words] of [
        ["Time by stage", "2 · reconstruct"],
        ["Details", /All \d+ options/],
        ["Log", "round 2 is delivered"],
      ]) {
        const summary = part(page, title).locator("summary").first();
        assert.notEqual(await summary.locator(".gist").textContent(), "");
        assert.equal(await part(page, title).getByText(words).first().isVisible(), false);
        await summary.tap();
        await part(page, title).getByText(words).first().waitFor();
      }
      await part(page, "Files").locator("summary").tap();
      await seen(part(page, "Files").locator("a"), "metrics.json");
      assert.deepEqual(await overflowing(page), []);
    },
    PHONE,
    { hasTouch: true },
  );
});
