// Captures and the form of options, at both widths, with played jobs.

import assert from "node:assert/strict";
import { after, before } from "node:test";

import { loaded, picture } from "./browser.js";
import { Stand, again, both, button, drop, part, provoked, seen } from "./played.js";
import { until } from "./until.js";

let stand;
let server;

before(async () => {
  stand = await Stand.start();
  ({ server } = stand);
});

after(() => stand?.stop());

const captureOf = async (id) => (await server.job(id)).capture_id;

both("captures are listed and can be opened by keyboard", async (width) => {
  await stand.finished();
  await stand.visit("captures", "", async (page) => {
    await page.getByRole("link", { name: "Captures" }).focus();
    await page.keyboard.press("Enter");
    // Not a link of the previous list.
    const link = page.locator("tbody a[href^=\"#/captures/\"]").first();
    await link.focus();
    await page.keyboard.press("Enter");
    await seen(page.getByText("photographs used"), "8 of 9");
    await part(page, "Photographs").waitFor();
    await seen(part(page, "Photographs").locator("tbody tr").first(), "broken.jpg");
    const used = part(page, "Photographs").locator("tbody tr").nth(1);
    await seen(used, "240 × 160");
    await seen(used.locator("td[data-label=Position]"), "placed");
    const [original] = await Promise.all([page.waitForEvent("popup"), used.getByRole("link").click()]);
    await until("it is the photograph", () => original.evaluate(() => document.images[0]?.naturalWidth === 240));
    await original.close();
    await seen(part(page, "Jobs").locator("tbody tr"), "a finished <b>job</b>");
  }, width);
});

both("the list of captures has a picture, the size and the jobs of each", async (width) => {
  await stand.finished();
  await stand.visit("captures-list", "#/captures", async (page) => {
    const row = page.locator("tbody tr", { hasText: "a finished <b>job</b>" }).last();
    await seen(row.locator("[data-label='Size, px']"), "240 × 160");
    await until("its picture is there", () => loaded(row.locator("img")));
    await picture(page, `page-captures-list-${width}`);
    const job = row.locator("[data-label='Newest jobs']").getByRole("link", { name: "a finished <b>job</b>" });
    await job.click();
    await seen(page.getByRole("heading", { level: 1 }), "a finished <b>job</b>");
  }, width);
});

both("a finished job can be run again with other options", async (width) => {
  const id = await stand.finished();
  await stand.visit("again", `#/jobs/${id}`, async (page) => {
    const form = await again(page, "40");
    assert.equal(await form.getByLabel("Preset").inputValue(), "preview");
    await form.getByLabel("Training steps", { exact: true }).fill("50");
    await form.getByLabel("Place missing photographs later", { exact: true }).uncheck();
    await form.getByText("Expert options").click();
    await form.getByLabel("Random seed", { exact: true }).fill("7");
    assert.deepEqual(await form.locator("legend").allInnerTexts(), ["Result", "Speed", "Poses"]);
    for (const name of ["Adapter", "Noise", "Enhance", "Lut scope"]) {
      assert.equal(await form.getByLabel(name, { exact: true }).count(), 0, name);
    }
    await seen(form, "Kept from that job: Adapter “ok”.");
    await picture(page, `page-options-${width}`);
    await form.getByLabel("Name", { exact: true }).fill(`again ${width}`);
    await button(form, "Run").click();
    await seen(page.getByRole("heading", { level: 1 }), `again ${width}`);
    const before = await server.job(id);
    const now = await server.job(page.url().split("/").pop());
    assert.equal(now.capture_id, before.capture_id);
    assert.deepEqual(now.options, { ...before.options, steps: 50, late_views: false, seed: 7 });
  }, width);
});

both("an option's error appears at its field and focuses it", async (width) =>
  stand.visit("bad-option", `#/captures/${await captureOf(await stand.finished())}`, async (page, faults) => {
    const form = part(page, "Run again with other options");
    for (const [name, value] of [["Brightness", "no such scene"], ["Deblurring network", "no such network"]]) {
      const field = form.getByLabel(name, { exact: true });
      const before = await field.inputValue().catch(() => "");
      if (!(await field.isVisible())) await form.getByText("Expert options").click();
      await field.fill(value);
      await button(form, "Run").click();
      const said = form.locator(".option", { has: page.getByLabel(name, { exact: true }) }).getByRole("alert");
      await seen(said, value);
      assert.equal(await field.getAttribute("aria-invalid"), "true");
      assert.equal(await field.evaluate((node) => node === document.activeElement), true);
      provoked(faults, 422);
      await field.fill(before);
      await said.waitFor({ state: "hidden" });
    }
    // All wrong numbers are found before anything is sent.
    const asked = [];
    page.on("request", (request) => request.method() === "POST" && asked.push(request.url()));
    await form.getByLabel("Training steps", { exact: true }).fill("0");
    await form.getByLabel("Random seed", { exact: true }).fill("1.5");
    await form.getByLabel("Image size", { exact: true }).fill("9000");
    await button(form, "Run").click();
    await seen(form.getByRole("alert"), "Training steps: enter a whole number from 1 to 200,000, or auto.");
    await seen(form.getByRole("alert"), "Random seed: enter a whole number from 0.");
    await seen(form.getByRole("alert"), "Image size: enter a whole number from 64 to 4,096, or auto.");
    assert.equal(await form.getByLabel("Image size", { exact: true }).evaluate((node) => node === document.activeElement), true);
    assert.deepEqual(asked, []);
    await picture(page, `page-bad-options-${width}`);
  }, width));

both("the form of a new job shows the preset's options and sends those that differ", async (width) =>
  stand.visit("new-options", "", async (page) => {
    await page.getByText("Options", { exact: true }).click();
    const size = page.getByLabel("Image size", { exact: true });
    await until("standard", async () => (await size.inputValue()) === "auto");
    await part(page, "New job").getByLabel("Preset").selectOption("preview");
    assert.equal(await size.inputValue(), "280");
    await page.getByLabel("Rounds", { exact: true }).fill("3");
    await page.getByLabel("Choose a folder").setInputFiles(stand.folder);
    await page.getByLabel("Name", { exact: true }).fill(`with options ${width}`);
    await button(page, "Start").click();
    await seen(page.getByRole("heading", { level: 1 }), `with options ${width}`);
    const { options, preset } = await server.job(page.url().split("/").pop());
    assert.deepEqual([preset, options.rounds, options.size, options.steps], ["preview", 3, 280, "auto"]);
    await seen(part(page, "Photographs"), "broken.jpg");
  }, width));

both("a capture is deleted after confirmation, but not while a job uses it", async (width) => {
  const name = `to be deleted ${width}`;
  const id = await server.submit(stand.folder, name, { adapter: "few_poses" });
  await server.reached(id, "failed");
  const capture = await captureOf(id);
  await stand.visit("delete-capture", `#/captures/${capture}`, async (page, faults) => {
    const dialog = page.getByRole("dialog");
    await part(page, "Jobs").locator("tbody tr").first().waitFor();
    await button(page, "Delete").click();
    await seen(dialog, "1 job uses this capture");
    await page.keyboard.press("Escape");
    await dialog.waitFor({ state: "detached" });
    await button(page, "Delete").click();
    await button(page, "Delete capture").click();
    await seen(page.getByRole("alert"), "A job uses this capture.");
    await seen(page.getByRole("alert"), "Delete its jobs first.");
    provoked(faults, 409);

    await page.getByRole("link", { name }).click();
    await button(page, "Delete").click();
    await button(page, "Delete job").click();
    await part(page, "New job").waitFor();
    await page.goto(`${server.base}/#/captures/${capture}`);
    await button(page, "Delete").click();
    await button(page, "Delete capture").click();
    await page.getByRole("heading", { name: "Captures", level: 1 }).waitFor();
    await until("it is gone", async () => (await page.locator(`a[href="#/captures/${capture}"]`).count()) === 0);
  }, width);
});

both("chosen files are listed with their faults before they are sent", async (width) =>
  stand.visit("chosen", "", async (page) => {
    const sent = [];
    page.on("request", (request) => request.method() !== "GET" && sent.push(request.url()));
    await page.getByLabel("Choose a folder").setInputFiles(stand.folder);
    const row = (name) => page.locator(".files li", { hasText: name });
    const image = row("images/000.png").locator("img");
    await image.scrollIntoViewIfNeeded();
    await until("a thumbnail is there", () => loaded(image));
    await row("broken.jpg").scrollIntoViewIfNeeded();
    await seen(row("broken.jpg"), "cannot be read as a picture");
    assert.equal(await row("images/000.png").locator(".bad").textContent(), "");
    await drop(page, ".drop", [["notes.pages", "words"], ["nothing.png", ""]]);
    await seen(row("notes.pages"), "not a photograph; it will not be used");
    await seen(row("nothing.png"), "empty file");
    await image.scrollIntoViewIfNeeded();
    assert.ok(await loaded(image), "it is not made anew");
    await picture(page, `page-chosen-${width}`);
    assert.deepEqual(sent, []);
  }, width));
