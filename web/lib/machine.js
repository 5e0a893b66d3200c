// The machine that the server runs on, and those that work for it.

import { api } from "./dom.js";

let asked = null;

/**
 * Asks the server what it has and lacks.
 * @returns {Promise<import("fled-api").Readiness>}
 */
export const readiness = () => (asked = fetch("/readyz").then((response) => response.json()));

/** Whether it said, when it was asked last, that it has no GPU. */
export async function lacksGpu() {
  try {
    return (await (asked ?? readiness())).has_gpu === false;
  } catch {
    return false;
  }
}

/**
 * Whether there are workers, for somebody who may see them.
 * @returns {Promise<boolean>}
 */
export const areWorkers = async () => (await api("/v1/workers")).workers.length > 0;
