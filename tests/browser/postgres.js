// A test's own PostgreSQL in a temporary folder on a free port, apart from the system's.

import { execFileSync, spawn } from "node:child_process";
import { chownSync, existsSync, mkdirSync, mkdtempSync, readFileSync, readdirSync, rmSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";

import { until } from "./until.js";

/** Debian's folder of PostgreSQL programs, which is not on the path. */
const DEBIAN = "/usr/lib/postgresql";

/** A program of the newest PostgreSQL installed. */
function program(name) {
  const versions = existsSync(DEBIAN) ? readdirSync(DEBIAN).sort((a, b) => Number(b) - Number(a)) : [];
  const paths = versions.map((version) => join(DEBIAN, version, "bin", name));
  return paths.find((path) => existsSync(path)) ?? name;
}

/** PostgreSQL refuses to run as root; then the user is `postgres` or `nobody`. */
function user() {
  if (process.getuid() !== 0) return {};
  const users = readFileSync("/etc/passwd", "utf8").split("\n").map((line) => line.split(":"));
  const found = ["postgres", "nobody"].map((name) => users.find(([one]) => one === name)).find(Boolean);
  return { uid: Number(found[2]), gid: Number(found[3]) };
}

/** A free port. */
const free = () =>
  new Promise((resolve, reject) => {
    const taken = createServer().once("error", reject);
    taken.listen(0, "127.0.0.1", () => {
      const { port } = taken.address();
      taken.close(() => resolve(port));
    });
  });

export class Postgres {
  static async start() {
    const folder = mkdtempSync(join(tmpdir(), "fled-postgres-"));
    const data = join(folder, "data");
    const as = user();
    mkdirSync(data, { mode: 0o700 });
    if (as.uid !== undefined) for (const path of [folder, data]) chownSync(path, as.uid, as.gid);
    const made = ["-U", "fled", "--auth=trust", "--encoding=UTF8", "--locale=C.UTF-8", "-D", data];
    execFileSync(program("initdb"), made, { ...as, cwd: folder, stdio: "ignore" });
    const port = await free();
    // Power cuts are not tested.
    const options = ["listen_addresses=127.0.0.1", "fsync=off"].flatMap((one) => ["-c", one]);
    const further = ["-D", data, "-p", String(port), "-k", folder, ...options];
    const child = spawn(program("postgres"), further, { ...as, cwd: folder, stdio: "ignore" });
    const postgres = new Postgres(folder, port, child);
    await until("PostgreSQL listens", () => postgres.#answers());
    return postgres;
  }

  constructor(folder, port, child) {
    Object.assign(this, { folder, child, port });
    this.address = `postgres://fled@127.0.0.1:${port}/postgres`;
  }

  #answers() {
    const asked = ["-q", "-h", "127.0.0.1", "-p", String(this.port), "-U", "fled"];
    try {
      execFileSync(program("pg_isready"), asked, { stdio: "ignore" });
      return true;
    } catch {
      return false;
    }
  }

  async stop() {
    const ended = new Promise((resolve) => { this.child.once("exit", resolve); });
    // Cuts open connections.
    this.child.kill("SIGINT");
    await ended;
    rmSync(this.folder, { recursive: true, force: true });
  }
}
