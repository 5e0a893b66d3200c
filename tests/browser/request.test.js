// The request that a finished job shows to be copied.

import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { after, before, test } from "node:test";
import { promisify } from "node:util";

import { Stand, button, part } from "./played.js";

const run = promisify(execFile);
const NAME = "a “quoted” \"name\" with $HOME, 'and' \\ more";

let stand;

before(async () => {
  stand = await Stand.start();
});

after(() => stand?.stop());

/** The requests by language, as a finished job's page shows them, and that job. */
async function shown(name) {
  const id = await stand.job("ok", NAME);
  await stand.server.reached(id, "succeeded");
  const texts = {};
  await stand.visit(name, `#/jobs/${id}`, async (page) => {
    const section = part(page, "Request");
    for (const language of ["curl", "Python", "JavaScript"]) {
      texts[language] = await section.locator(`pre[aria-label=${language}]`).textContent();
    }
    await button(section, "Copy curl").click();
    await section.getByText(/Copied|Selected: copy it/).waitFor();
  });
  return { texts, job: await stand.server.job(id) };
}

test("each request starts a job like the one that shows it", async () => {
  const { texts, job } = await shown("request");
  const environment = { ...process.env, HOME: "/nowhere" };
  const curl = await run("sh", ["-c", `${texts.curl} --silent`], { env: environment });
  const python = await run("python3", ["-c", texts.Python], { env: environment });
  const script = await run("node", ["--input-type=module", "--eval", texts.JavaScript], { env: environment });
  for (const id of [JSON.parse(curl.stdout).id, python.stdout.trim(), script.stdout.trim()]) {
    const made = await stand.server.job(id);
    assert.notEqual(made.id, job.id);
    for (const key of ["capture_id", "preset", "options", "name", "priority"]) assert.deepEqual(made[key], job[key], key);
  }
});

test("the request takes the token from a variable", async () => {
  const { texts } = await shown("request-open");
  for (const text of Object.values(texts)) assert.ok(!text.includes("FLED_TOKEN"), text);
  const id = await stand.job("ok", NAME);
  const token = stand.server.token();
  await stand.visit("request-token", `#/jobs/${id}`, async (page) => {
    await page.getByLabel("Token").fill(token);
    await button(page, "Log in").click();
    const section = part(page, "Request");
    for (const [language, word] of [["curl", "$FLED_TOKEN"], ["Python", "os.environ"], ["JavaScript", "process.env"]]) {
      const text = await section.locator(`pre[aria-label=${language}]`).textContent();
      assert.ok(text.includes(word) && !text.includes(token), text);
    }
    const text = await section.locator("pre[aria-label=curl]").textContent();
    const made = await run("sh", ["-c", `${text} --silent --fail`], { env: { ...process.env, FLED_TOKEN: token } });
    assert.ok(JSON.parse(made.stdout).id);
  });
});
