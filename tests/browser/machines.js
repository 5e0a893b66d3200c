// Workers as a server would report them, in states that are hard to cause.

const GIB = 2 ** 30;
/** The database's clock is an hour ahead of the other clocks. */
const AHEAD_MS = 3600e3;

/** A worker on a host, with further fields. */
function machine(at, host, further) {
  return {
    id: `0199a3c4-0000-7000-8000-${Buffer.from(host).toString("hex").padEnd(12, "0").slice(-12)}`,
    host,
    version: "0.9.0",
    adapter: "NVIDIA H100 80GB HBM3 (Vulkan, driver 575.57.08)",
    has_gpu: true,
    cores: 16,
    memory: 125.5 * GIB,
    jobs: 1,
    state: "works",
    started_at: at(3 * 86400),
    seen_at: at(4),
    running: [],
    ...further,
  };
}

/** A worker of every kind. The first two jobs run on the first worker, the third on the second. */
export function machines([one, other, third] = []) {
  const now = Date.now() + AHEAD_MS;
  const at = (seconds) => new Date(now - 1000 * seconds).toISOString();
  const runs = (id, speed) => (id ? [{ job_id: id, steps_per_second: speed }] : []);
  return {
    now: at(0),
    workers: [
      machine(at, "gpu-10", {
        jobs: 4,
        running: [...runs(one, 41.27), ...runs(other, null)],
        started_at: at(7500),
      }),
      machine(at, "gpu-2", { state: "stops", running: runs(third, 3.5), version: "0.10.0" }),
      machine(at, "old.rack-7.basement.example.org", { state: "lost", seen_at: at(1800), version: "0.8.1" }),
      machine(at, "plain", { adapter: null, has_gpu: false, cores: 1, memory: 0 }),
      machine(at, "soft", { adapter: "llvmpipe (LLVM 19.1.7, 256 bits)", has_gpu: false, memory: 8 * GIB }),
    ],
  };
}

/** Makes a page see these workers from now on. */
export const tell = (page, workers) =>
  page.route("**/v1/workers", (route) => route.fulfill({ json: workers() }));

/** Makes a page see these jobs when it asks for jobs in a state. */
export const tellJobs = (page, jobs) =>
  page.route("**/v1/jobs?state=*", (route) => {
    const { searchParams } = new URL(route.request().url());
    return route.fulfill({ json: { jobs: jobs[searchParams.get("state")] ?? [], next_cursor: null } });
  });

/** Makes a page see the server's answers as changed by `change`. */
export async function change(page, path, change) {
  await page.route(path, async (route) => {
    const response = await route.fetch();
    const json = await response.json();
    return route.fulfill({ response, json: change(json) });
  });
}
