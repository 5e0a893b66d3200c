// Runs the real program as a server on a free port, with a temporary folder.

import { execFileSync, spawn } from "node:child_process";
import { cpSync, existsSync, mkdtempSync, readdirSync, readFileSync, renameSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, relative } from "node:path";
import { createInterface } from "node:readline";

import { until } from "./until.js";

/** Options of a job of seconds, whose result is not judged. */
const SMALL = {
  size: 96,
  steps: 40,
  cap: 1000,
  rounds: 2,
  held_out: "4",
  pose_source: "given",
  deblur: "identity",
};

/** The program finds the files of `make onnxruntime` here. */
const TOP = join(import.meta.dirname, "../..");

/** Time limit for the end of a server, ms. */
const FAREWELL = 10_000;

/** The program beside this one that plays jobs. */
export const fake = (program) => process.env.FLED_FAKE ?? join(dirname(program), "fled-fake");

export class Server {
  /** Starts `program serve` with further arguments; resolves once it listens. */
  static async start(program, further = []) {
    const server = new Server(program, mkdtempSync(join(tmpdir(), "fled-browser-")));
    await server.#serve(further);
    return server;
  }

  constructor(program, folder) {
    Object.assign(this, { program, folder, said: [], farewell: "SIGTERM" });
  }

  async #serve(further, address = "127.0.0.1:0") {
    const { folder } = this;
    const environment = { ...process.env, FLED_MODELS: join(folder, "models") };
    delete environment.RUST_LOG;
    const data = join(folder, "data");
    const listen = ["--listen", address, "--workers", "2"];
    this.child = spawn(
      this.program,
      ["serve", "--data", data, ...listen, ...further],
      { cwd: TOP, env: environment, stdio: ["ignore", "ignore", "pipe"] },
    );
    this.base = await this.#address();
  }

  /**
   * A server that plays jobs, for page states that a real job only passes through. A job's plan is
   * its option `adapter`; the name of a stage and the milliseconds of a tenth of it prolong that
   * stage. `further` is added to its environment.
   */
  static async played(program, further = {}) {
    const server = new Server(program, mkdtempSync(join(tmpdir(), "fled-played-")));
    const place = join(server.folder, "address");
    const models = join(server.folder, "models");
    const environment = { ...process.env, FLED_MODELS: models, ...further };
    const data = join(server.folder, "data");
    server.child = spawn(fake(program), ["serve", data, place], { env: environment, stdio: "ignore" });
    server.farewell = "SIGINT";
    const found = () => {
      try { return readFileSync(place, "utf8"); } catch { return null; }
    };
    server.base = `http://${await until("the played server listens", found)}`;
    return server;
  }

  /** Restarts the server on its data with further arguments. */
  async restart(further = []) {
    await this.#end();
    await this.#serve(further);
  }

  /** Kills the server, like a power cut, and starts it again. */
  async killed() {
    const ended = new Promise((resolve) => { this.child.once("exit", resolve); });
    this.child.kill("SIGKILL");
    await ended;
    await this.#serve([], new URL(this.base).host);
  }

  #address() {
    return new Promise((resolve, reject) => {
      createInterface({ input: this.child.stderr }).on("line", (line) => {
        this.said.push(line);
        const address = line.match(/listening on (http:\S+)/);
        if (address) resolve(address[1]);
      });
      this.child.on("error", reject);
      this.child.on("exit", (code) => {
        reject(new Error(`the server ended with ${code}:\n${this.said.join("\n")}`));
      });
    });
  }

  /** Creates a token with a scope; from the first one on the server requires a token. */
  token(scope = "admin") {
    const data = join(this.folder, "data");
    const said = execFileSync(
      this.program,
      ["token", "create", "--data", data, "--scope", scope, "--name", "browser"],
      { encoding: "utf8" },
    );
    return said.match(/fled_[0-9a-f]{64}/)[0];
  }

  async stop() {
    await this.#end();
    rmSync(this.folder, { recursive: true, force: true });
  }

  async #end() {
    const { child } = this;
    if (child.exitCode === null && child.signalCode === null) {
      const ended = new Promise((resolve) => { child.once("exit", resolve); });
      const impatience = setTimeout(() => child.kill("SIGKILL"), FAREWELL);
      child.kill(this.farewell);
      await ended;
      clearTimeout(impatience);
    }
  }

  /** A folder of small dark photographs with poses and ground truth. */
  capture(size = "96x64", views = 8, room = "0", layout = "lush") {
    const folder = join(this.folder, "capture");
    cpSync(photographs(this.program, { size, views, room, layout }), folder, { recursive: true });
    return folder;
  }

  /** The capture, its poses by name, with one file that is not a photograph. */
  spoilt(size) {
    const folder = this.capture(size, 8, "0", "transforms");
    writeFileSync(join(folder, "images", "broken.jpg"), "no photograph");
    return folder;
  }

  /** Submits a small job of the capture with further options; returns its id. */
  async submit(capture, name, options = {}, preset = "preview") {
    const body = new FormData();
    body.append("name", name);
    body.append("preset", preset);
    body.append("options", JSON.stringify({ ...SMALL, ...options }));
    for (const path of files(capture)) {
      body.append("images", new Blob([readFileSync(path)]), relative(capture, path));
    }
    const { id } = await this.#json("/v1/jobs", { method: "POST", body });
    return id;
  }

  /** Makes the recorded job of the sample, which has finished at once; returns its id. */
  async sample() {
    const { id } = await this.#json("/v1/captures/sample", { method: "POST" });
    const { jobs } = await this.#json(`/v1/jobs?capture_id=${id}`);
    return jobs[0].id;
  }

  /** The job as in the API. */
  job(id) {
    return this.#json(`/v1/jobs/${id}`);
  }

  /** Waits until `probe` accepts a job. */
  when(id, what, probe, patience) {
    return until(`job ${id} ${what}`, async () => probe(await this.job(id)), patience);
  }

  /** Cancels a job in any state. */
  cancel(id) {
    return this.#json(`/v1/jobs/${id}/cancel`, { method: "POST" });
  }

  /** The scores of a job as in the API. */
  rounds(id) {
    return this.#json(`/v1/jobs/${id}/rounds`);
  }

  /** Waits until a job has ended in `state`. */
  async reached(id, state, patience) {
    const name = await this.when(id, "is over", (job) => job.finished_at && job.state, patience);
    if (name !== state) {
      const { error } = await this.job(id);
      throw new Error(`the job is ${name}, not ${state}: ${JSON.stringify(error)}`);
    }
  }

  async #json(path, options) {
    const response = await fetch(this.base + path, options);
    const text = await response.text();
    if (!response.ok) throw new Error(`${path}: ${response.status} ${text}`);
    return JSON.parse(text);
  }
}

/**
 * Photographs for all files of tests: to render them takes seconds. `npm ci`, which begins each
 * `make test-browser`, removes them.
 */
function photographs(program, choices) {
  const whole = join(import.meta.dirname, "node_modules", ".photographs", Object.values(choices).join("-"));
  if (existsSync(whole)) return whole;
  const part = `${whole}.${process.pid}`;
  const options = Object.entries(choices).flatMap(([name, value]) => [`--${name}`, String(value)]);
  execFileSync(program, ["synth", part, ...options], { stdio: "ignore" });
  try {
    renameSync(part, whole);
  } catch {
    // Another file of tests was faster.
    rmSync(part, { recursive: true });
  }
  return whole;
}

/** Every file below a folder. */
function files(folder) {
  return readdirSync(folder, { withFileTypes: true }).flatMap((entry) => {
    const path = join(folder, entry.name);
    return entry.isDirectory() ? files(path) : [path];
  });
}
