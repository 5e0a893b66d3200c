// One job, live.

import { chart } from "./chart.js";
import { address, api, doing, duration, h, pill, plain } from "./dom.js";
import { poses } from "./poses.js";
import { shares } from "./share.js";
import { comparison, novelView } from "./views.js";

const STAGES = ["poses", "enhance", "deblur", "reconstruct", "render", "match", "evaluate"];
const EVENTS = ["state", "planned", "stage_started", "stage_finished", "progress", "round_finished", "warning"];
const LOG_MS = 2000;

/** The page of job `id` for whoever `who` is: a visitor by a link only looks. */
export function jobPage(main, id, who) {
  const base = `/v1/jobs/${id}`;
  const head = h("section");
  const problem = h("p", { class: "problem", role: "alert" });
  const warnings = section("Warnings");
  const metrics = section("Metrics by round");
  const times = section("Time by stage");
  const facts = section("Facts");
  const files = section("Files");
  const views = comparison(id);
  const novel = novelView(id);
  const log = who.job ? null : logView(base);
  const share = who.scopes !== null && !who.job ? shares(id) : null;
  main.append(head, problem, warnings, metrics, views.root, novel.root, h("div", { class: "columns" }, times, facts), files,
    ...[share?.root, log?.root].filter(Boolean));
  share?.open();

  let stream = null;
  let gone = false;
  let cameras = null;
  let reported = "";

  async function refresh() {
    try {
      const job = await api(base);
      if (gone) return;
      showHead(job);
      show(warnings, job.warnings.length > 0 && h("ul", { class: "plain" },
        job.warnings.map((warning) => h("li", {}, `${plain(warning.code)}: ${warning.message}`))));
      show(times, job.stages.length > 0 && stageBars(job.stages));
      log?.follow(job.state === "running" || job.state === "queued");
      if (!stream && !["succeeded", "failed", "cancelled"].includes(job.state)) listen();
      // Only rounds and states change these; a progress event does not.
      const report = `${job.state} ${job.stages.length}`;
      if (report !== reported) {
        reported = report;
        await showResults(job);
      }
    } catch (error) {
      if (!gone) problem.textContent = error.message;
    }
  }

  async function showResults(job) {
    const report = await api(`${base}/rounds`);
    if (gone) return;
    show(metrics, report.rounds.length > 0 && metricCharts(report.rounds));
    show(facts, factList(job, report), report.registered !== undefined && poses(base, report));
    const rounds = report.rounds.map((round) => round.round);
    if (rounds.length === 0) return;
    if (!cameras) cameras = await api(`${base}/artifacts/cameras.json`).catch(() => null);
    const hasTruth = report.rounds.some((round) => round.records.some((record) => record.reference === "gt"));
    if (cameras) views.update(cameras, rounds, hasTruth);
    novel.update(rounds);
    if (job.state === "succeeded") await showFiles();
  }

  async function showFiles() {
    const { artifacts } = await api(`${base}/artifacts`);
    const top = artifacts.filter((file) => !file.name.includes("/") || file.name.endsWith("scene.ply"));
    show(files, h("table", {}, h("tbody", {}, top.map((file) => h("tr", {},
      h("td", {}, h("a", { href: `${base}/artifacts/${address(file.name)}`, download: file.name.split("/").pop() }, file.name)),
      h("td", { class: "number" }, size(file.bytes)),
      h("td", { class: "wide soft" }, `sha256 ${file.sha256.slice(0, 16)}…`))))),
      h("p", { class: "hint" }, `${artifacts.length} files in all: `, h("a", { href: `${base}/artifacts` }, "list"), ", ",
        h("a", { href: `${base}/rounds?format=csv`, download: "rounds.csv" }, "metrics as CSV")));
  }

  function showHead(job) {
    const act = (label, path, method = "POST") => h("button", {
      type: "button",
      onclick: async (event) => {
        event.target.disabled = true;
        problem.textContent = "";
        try {
          await api(path, { method });
          if (path === base) location.hash = "#/";
          else await refresh();
        } catch (error) {
          problem.textContent = error.message;
          event.target.disabled = false;
        }
      },
    }, label);
    const over = ["succeeded", "failed", "cancelled"].includes(job.state);
    const line = [doing(job), job.steps_per_second ? `${job.steps_per_second.toFixed(1)} steps/s` : "",
      job.eta_seconds && job.state === "running" ? `${duration(job.eta_seconds)} left` : "",
      job.attempts > 1 ? `attempt ${job.attempts}` : ""].filter(Boolean).join(" · ");
    head.replaceChildren(
      h("div", { class: "row" }, h("h1", {}, job.name || "unnamed"), pill(job), h("span", { class: "soft" }, line),
        !who.job && h("span", { class: "row push" },
          !over && act("Cancel", `${base}/cancel`),
          (job.state === "failed" || job.state === "cancelled") && act("Try again", `${base}/retry`),
          job.state !== "running" && act("Delete", base, "DELETE"))),
      who.job ? "" : keeping(job, act),
      h("p", { class: "hint" }, `${job.preset} · created ${new Date(job.created_at).toLocaleString()}`),
      h("progress", { max: 1, value: job.progress, "aria-label": "progress" }));
    if (job.error) {
      head.append(h("p", { class: "problem" }, `${plain(job.error.code)}: ${job.error.detail}\n${job.error.hint}`));
    }
    document.title = `${job.name || "job"} · fled`;
  }

  /** What the server will do with the job of itself, and how to keep it. */
  function keeping(job, act) {
    if (job.pinned) return h("p", { class: "row hint" }, "Kept until you delete it.", act("Keep no longer than others", `${base}/pin`, "DELETE"));
    if (!job.expires_at) return "";
    const day = new Date(job.expires_at).toLocaleString();
    return h("p", { class: "row problem" }, `This job will be deleted on ${day}.`, act("Keep it", `${base}/pin`, "PUT"));
  }

  function listen() {
    stream = new EventSource(`${base}/events`);
    let queued = 0;
    for (const name of EVENTS) {
      stream.addEventListener(name, () => {
        // The whole history comes at first: one refresh is enough for many events.
        if (!queued) queued = setTimeout(() => { queued = 0; refresh(); }, 250);
      });
    }
    stream.onerror = () => {
      if (stream?.readyState !== EventSource.CLOSED) return;
      stream = null;
      if (!gone) refresh();
    };
  }

  refresh();
  return () => {
    gone = true;
    stream?.close();
    log?.follow(false);
    document.title = "fled";
  };
}

function section(title) {
  const node = h("section", { hidden: true }, h("h2", {}, title));
  node.content = h("div");
  node.append(node.content);
  return node;
}

function show(node, ...content) {
  const real = content.filter(Boolean);
  node.hidden = real.length === 0;
  if (real.length > 0) node.content.replaceChildren(...real.flat());
}

/** Against ground truth it is quality; against our own images it is only self-consistency. */
function metricCharts(rounds) {
  const groups = [
    ["against ground truth", ["gt"], "final"],
    ["self-consistency: renders against our own deblurred views, not quality", ["deblurred"], "native"],
  ];
  const nodes = [];
  for (const [label, references, brightness] of groups) {
    const series = lines(rounds, references, brightness);
    if (series.length === 0) continue;
    const values = (key) => series
      .map((one) => ({ ...one, points: one.records.map(([round, record]) => [round, record[key]]).filter(([, v]) => Number.isFinite(v)) }))
      .filter((one) => one.points.length > 0);
    const psnr = references[0] === "gt" ? "psnr_cc_db" : "psnr_db";
    const title = psnr === "psnr_cc_db" ? "PSNR after colour fit, dB" : "PSNR, dB";
    nodes.push(h("h3", {}, label), h("div", { class: "charts" }, chart(title, values(psnr), 1), chart("SSIM", values("ssim"), 2, 1)));
  }
  if (!nodes.some((node) => node.textContent.includes("ground truth"))) {
    nodes.push(h("p", { class: "hint" }, "The capture has no ground truth: what is shown says how well the scene agrees with its own training images."));
  }
  nodes.push(roundTable(rounds));
  return nodes;
}

function lines(rounds, references, brightness) {
  const series = [];
  for (const [colour, image, label] of [[0, "render", "rendered"], [1, "deblurred", "deblurred"], [2, "enhanced", "enhanced only"]]) {
    for (const [split, dashed] of [["held_out", false], ["train", true]]) {
      const records = rounds.flatMap((round) => {
        const fits = round.records.filter((r) => r.image === image && r.split === split && references.includes(r.reference));
        // Where the wanted brightness was not measured, the other one is better than nothing.
        const record = fits.find((r) => r.brightness === brightness) ?? fits[0];
        return record ? [[round.round, record]] : [];
      });
      if (records.length > 0) series.push({ label: `${label}, ${plain(split)} (${records[0][1].views} views)`, colour, dashed, records });
    }
  }
  return series;
}

function roundTable(rounds) {
  const cells = (round) => [round.round, duration(round.seconds), round.gaussians.toLocaleString(), round.steps.toLocaleString(),
    round.steps_per_second?.toFixed(1), round.noise_sigma?.render?.toFixed(4) ?? round.noise_sigma?.renders?.toFixed(4) ?? "",
    round.shake_px?.toFixed(2), round.pose_correction_px?.toFixed(2), round.worse_than_previous ? "worse than the round before" : ""];
  return h("div", { class: "scroll" }, h("table", {},
    h("thead", {}, h("tr", {}, ["Round", "Time", "Gaussians", "Steps", "Steps/s", "Noise of renders", "Shake found, px", "Cameras moved, px", ""].map((t) => h("th", {}, t)))),
    h("tbody", {}, rounds.map((round) => h("tr", {}, cells(round).map((text) => h("td", {}, String(text ?? ""))))))));
}

function stageBars(stages) {
  const rows = [...stages].sort((a, b) => a.round - b.round || STAGES.indexOf(a.stage) - STAGES.indexOf(b.stage));
  const most = Math.max(...rows.map((row) => row.seconds));
  return h("div", { class: "bars" }, rows.flatMap((row) => [
    h("span", {}, row.round > 0 ? `${row.round} · ${row.stage}` : row.stage),
    h("progress", { max: most || 1, value: row.seconds, "aria-label": row.stage }),
    h("span", { class: "number" }, duration(row.seconds))]));
}

function factList(job, report) {
  const flat = (value) => (typeof value === "object" && value !== null
    ? Object.entries(value).filter(([, v]) => v !== undefined).map(([k, v]) => `${plain(k)} ${flat(v)}`).join(", ") : String(value));
  const rows = [["registered", report.registered !== undefined ? `${report.registered} of ${report.views} views` : null],
    ["delivered round", report.best_round], ["adapter", report.adapter], ["poses", report.poses && flat({ ...report.poses, verdicts: undefined })],
    ["models", report.models && flat(report.models)], ["fallbacks", report.fallbacks?.join("; ")], ["options", flat(job.options)]];
  return h("dl", {}, rows.filter(([, value]) => value !== null && value !== undefined && value !== "")
    .flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, String(value))]));
}

function logView(base) {
  const text = h("pre", { tabIndex: 0, "aria-label": "log" });
  const root = h("section", {}, h("h2", {}, "Log"), text);
  let [offset, timer, active, busy] = [0, 0, false, false];

  async function read() {
    if (busy) return;
    busy = true;
    clearTimeout(timer);
    try {
      for (let end = false; !end;) {
        const page = await api(`${base}/log?offset=${offset}&limit=2000`);
        const below = text.scrollHeight - text.scrollTop - text.clientHeight < 30;
        if (page.lines.length > 0) text.append(`${page.lines.join("\n")}\n`);
        if (below) text.scrollTop = text.scrollHeight;
        offset = page.next_offset;
        end = page.end;
      }
    } catch { /* The next reading goes on where this one ended. */ }
    busy = false;
    if (active) timer = setTimeout(read, LOG_MS);
  }
  read();
  return {
    root,
    follow(now) {
      // Once more at the end: the last lines are the interesting ones.
      if (now !== active) { active = now; read(); }
    },
  };
}

function size(bytes) {
  if (bytes < 1000) return `${bytes} B`;
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(1)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}
