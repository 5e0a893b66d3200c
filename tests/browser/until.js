// Waiting, with words for what never came.

import { setTimeout as sleep } from "node:timers/promises";

/** A small job takes seconds alone, but the machine may be busy. */
export const PATIENCE = 60_000;

/** Asks again and again; what `probe` answers first that is not falsy. */
export async function until(what, probe, patience = PATIENCE) {
  const end = Date.now() + patience;
  for (;;) {
    const answer = await probe();
    if (answer) return answer;
    if (Date.now() > end) throw new Error(`not within ${patience / 1000} s: ${what}`);
    await sleep(100);
  }
}
