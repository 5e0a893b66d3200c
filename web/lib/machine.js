// The server's machine, and its workers.

import { api } from "./dom.js";

let asked = null;

/**
 * Asks the server which of its requirements are met.
 * @returns {Promise<import("fled-api").Readiness>}
 */
export const readiness = () => (asked = fetch("readyz").then((response) => response.json()));

/** Whether the server's last answer reported no GPU. */
export async function lacksGpu() {
  try {
    return (await (asked ?? readiness())).has_gpu === false;
  } catch {
    return false;
  }
}

/**
 * Whether there are workers; the session must be allowed to see them.
 * @returns {Promise<boolean>}
 */
export const areWorkers = async () => (await api("v1/workers")).workers.length > 0;
