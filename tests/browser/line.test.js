// The line beside a running job's state, without a browser.

import assert from "node:assert/strict";
import { test } from "node:test";

import { presetOf, progressLine } from "../../web/lib/state.js";

/** A job that has searched for poses for some seconds. */
const searching = (seconds, eta = null) => ({
  state: "running", stage: "poses", round: 0, rounds: 2, attempts: 1, options: {}, eta_seconds: eta,
  stage_started_at: new Date(Date.now() - 1000 * seconds).toISOString(),
});
const strategies = ["features found and matched by networks", "COLMAP's features on small copies"];

test("the search for poses tells the time left, as long as some is left", () => {
  const matched = { done: 206, total: 496 };
  const search = { matched, strategies: strategies.slice(0, 1) };
  assert.equal(progressLine(searching(388, 400), search, 3),
    "poses · 6 min 37 s left · 206 of 496 photographs and pairs matched · 6:28 so far");
  const late = progressLine(searching(388, 13), { matched: null, strategies }, 14);
  assert.match(late, / so far; longer than usual$/);
  assert.doesNotMatch(late, /left/);
});

test("a strategy that follows others has a name and a number", () => {
  const at = (tried, seconds) => progressLine(searching(seconds), { matched: null, strategies: tried }, 0);
  assert.equal(at(strategies.slice(0, 1), 20), "poses · 0:20 so far; usually one to two minutes");
  assert.equal(at(strategies, 20), `poses · second try: ${strategies[1]} · 0:20 so far; usually one to two minutes`);
  assert.equal(at([...strategies, "another"], 20), "poses · third try: another · 0:20 so far; longer than usual");
  assert.equal(at(strategies.slice(0, 1), 121), "poses · 2:01 so far; longer than usual");
});

test("a limit of time stands beside the preset, whose numbers it replaces", () => {
  const job = { preset: "auto", detail: { level: "standard" }, options: { minutes: "auto" } };
  assert.equal(presetOf(job), "auto: standard");
  assert.equal(presetOf({ ...job, options: { minutes: 3 } }), "auto: standard, at most 3 minutes");
  const detail = { level: "high", because: "a GPU" };
  assert.equal(presetOf({ ...job, detail, options: { minutes: 3 } }, true),
    "auto: high (a GPU), at most 3 minutes");
  assert.equal(presetOf({ preset: "high", options: { minutes: 1 } }), "high, at most 1 minute");
});
