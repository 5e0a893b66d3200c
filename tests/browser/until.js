// Waiting with a message on timeout.

import { setTimeout as sleep } from "node:timers/promises";

/** Default timeout, ms: a small job takes seconds, but the machine may be busy. */
export const PATIENCE = 60_000;

/** Polls `probe` and returns its first truthy result. */
export async function until(what, probe, patience = PATIENCE) {
  const end = Date.now() + patience;
  for (;;) {
    const answer = await probe();
    if (answer) return answer;
    if (Date.now() > end) throw new Error(`not within ${patience / 1000} s: ${what}`);
    await sleep(100);
  }
}
