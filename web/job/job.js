// One job, live.

import { address, api, count, fold, folding, h, nothing, prose, section, show, size } from "../lib/dom.js";
import { contents } from "../lib/contents.js";
import { byView } from "./by_view.js";
import { exportList } from "./exports.js";
import { factList, optionList, stageBars } from "./facts.js";
import { jobHead } from "./head.js";
import { logView } from "./log.js";
import { metricCharts } from "./metrics.js";
import { novelView } from "./novel.js";
import { leftOut, strip } from "../lib/photographs.js";
import { overlapMap } from "./overlap.js";
import { camerasMap } from "./poses.js";
import { hasTruth } from "./records.js";
import { requestOf } from "./request.js";
import { scenePanel } from "../scene/panel.js";
import { shares } from "./share.js";
import { summary } from "./summary.js";
import { notable } from "./verdict.js";
import { newShaping } from "../lib/shaping.js";
import { isOver } from "../lib/state.js";
import { SEEN, trainingView } from "./training.js";
import { hasWebGl } from "../lib/webgl.js";
import { videos } from "./videos.js";
import { comparison } from "./views.js";

const EVENTS = ["state", "planned", "detail_chosen", "stage_started", "strategy_started", "stage_finished", "progress", "round_finished", "warning"];
/** The queue position depends on other jobs, which the job's own events do not report. */
const QUEUE_MS = 3000;

/** The page of job `id` for the session `who`; a visitor by a link can only look. */
export function jobPage(main, who, id) {
  const base = `v1/jobs/${id}`;
  const isVisitor = who.job !== null;
  const head = jobHead(base, refresh, who);
  const problem = h("p", { class: "problem", role: "alert" });
  const unused = section("Photographs");
  const warnings = section("Warnings");
  const training = trainingView(base);
  const metrics = section("Metrics by round");
  const times = folding("Time by stage");
  const facts = folding("Details");
  const request = folding("Request");
  const files = section("Files");
  const shaping = newShaping();
  const filmed = videos(id, isVisitor, shaping);
  const exported = folding("Export");
  const views = comparison(id);
  const scores = byView(views.open);
  const scene = scenePanel(id, {}, shaping);
  // If the browser draws the scene, the server need not turn it.
  const novel = hasWebGl() ? null : novelView(id);
  // If the server needs no tokens, a link has no purpose.
  const share = who.scopes !== null && !isVisitor ? shares(id) : null;
  const log = isVisitor ? null : logView(base);
  // The important parts come first, because on a phone the rest is far below.
  const bar = contents(main, { training: training.root, views: views.root, scene: scene.root, scores: scores.root, metrics, files, export: exported,
    ...(novel && { novel: novel.root }), videos: filmed.root, photographs: unused, time: times, details: facts,
    request, ...(share && { share: share.root }), ...(log && { log: log.root }) });
  main.append(head.root, bar.root, problem, training.root, views.root, warnings, scene.root, scores.root, metrics, files,
    exported, ...(novel ? [novel.root] : []), filmed.root, unused, h("div", { class: "columns" }, times, facts),
    request, ...[share, log].filter(Boolean).map((part) => part.root));
  share?.open();

  /** @type {import("fled-api").Capture | null} */
  let uploaded = null;
  let isEarly = false;
  let [stream, isHeard, hasEnded, timer, gone, cameras, placed, capture, given, reported] = [null, false, false, 0, false, null, 0, null, undefined, ""];

  async function refresh() {
    clearTimeout(timer);
    try {
      /** @type {import("fled-api").Job} */
      const job = await api(base);
      if (gone) return;
      hasEnded = isOver(job);
      head.update(job);
      problem.textContent = "";
      show(warnings, job.warnings.length > 0 && h("ul", { class: "plain" },
        job.warnings.map((warning) => h("li", {}, prose(warning.message)))));
      show(times, job.stages.length > 0 && stageBars(job));
      log?.follow(!isOver(job));
      if (isOver(job)) {
        training.over();
        // The result comes before its history.
        if (metrics.nextSibling !== training.root) metrics.after(training.root);
      }
      // The events also hold the curves of a job that is over.
      if (!stream && !(isOver(job) && isHeard)) listen();
      if (job.state === "queued") timer = setTimeout(refresh, QUEUE_MS);
      if (!isVisitor) capture ??= takeCapture(job);
      // Rounds and states change these; progress events do not.
      const report = `${job.state} ${job.attempts} ${job.stages.length}`;
      if (report !== reported) {
        reported = report;
        showPhotographs(job);
        await showResults(job);
      }
    } catch (error) {
      if (gone) return;
      if (error.status === 404) nothing(main, "Job not found.");
      else {
        problem.textContent = error.message;
        timer = setTimeout(refresh, QUEUE_MS);
      }
    }
  }

  /** Loads the capture, once, as it does not change. */
  async function takeCapture(job) {
    /** @type {import("fled-api").Capture | null} */
    const found = await api(`v1/captures/${job.capture_id}`).catch(() => null);
    if (!found || gone) return;
    uploaded = found;
    given = found.images.length;
    // Before the first round, and if there is none, there is nothing else to show.
    isEarly = !job.stages.some(({ stage, round }) => (isOver(job) ? stage === "evaluate" : round > 0));
    showPhotographs(job);
  }

  /** Shows the photographs left out of the upload and, of a failed job, which match one another. */
  function showPhotographs(job) {
    if (!uploaded) return;
    const apart = isOver(job) && job.error?.code === "few_poses" && job.overlap;
    show(unused, apart && overlapMap(uploaded, apart), leftOut(uploaded), isEarly && !apart && strip(uploaded));
  }

  async function showResults(job) {
    const report = await api(`${base}/rounds`);
    if (gone) return;
    show(metrics, report.rounds.length > 0 && metricCharts(report.rounds));
    show(facts, factList(report), optionList(job), report.registered !== undefined && camerasMap(base));
    scores.update(report);
    // A visitor cannot start jobs.
    if (isOver(job) && !isVisitor) show(request, await requestOf(job, who.needed).catch(() => null));
    const rounds = report.rounds.map((round) => round.round);
    const { artifacts } = await api(`${base}/artifacts`);
    if (gone) return;
    // A round may find poses for views without one.
    const isThere = artifacts.some(({ name }) => name === "cameras.json");
    if (isThere && (!cameras || placed !== rounds.length)) {
      [cameras, placed] = [await api(`${base}/artifacts/cameras.json`).catch(() => null), rounds.length];
      if (gone) return;
    }
    scene.update(job.name || id, cameras ?? [], artifacts, report.best_round, notable(report)?.best);
    if (rounds.length === 0) return;
    if (isEarly) {
      isEarly = false;
      showPhotographs(job);
    }
    if (cameras) views.update(cameras, rounds, hasTruth(report.rounds), notable(report));
    novel?.update(rounds.filter((round) => artifacts.some(({ name }) => name === `rounds/${round}/scene.ply`)));
    if (job.state !== "succeeded") return;
    showFiles(artifacts);
    await capture;
    if (gone) return;
    head.sum(summary(job, report, artifacts, given, share?.root, views.open, shaping));
    filmed.open(cameras ?? []);
    show(exported, await exportList(base, shaping));
  }

  function showFiles(artifacts) {
    const top = artifacts.filter((file) => !file.name.includes("/") || file.name.endsWith("scene.ply"));
    const isScene = (file) => file.name === "scene.ply";
    const rest = top.filter((file) => !isScene(file));
    show(files, fileTable(base, top.filter(isScene)),
      rest.length > 0 && fold(count(rest.length, "more file"), fileTable(base, rest)), h("p", { class: "hint" }, `${artifacts.length} files in total: `, h("a", { href: `${base}/artifacts` }, "list"), ", ",
      h("a", { href: `${base}/rounds?format=csv`, download: "rounds.csv" }, "metrics as CSV")));
  }

  function listen() {
    stream = new EventSource(`${base}/events`);
    isHeard = true;
    let queued = 0;
    for (const name of EVENTS) {
      stream.addEventListener(name, () => {
        // The stream begins with the whole history: one refresh serves many events, and none is
        // needed if the job has ended.
        if (!queued && !hasEnded) queued = setTimeout(() => { queued = 0; refresh(); }, 250);
      });
    }
    stream.addEventListener("progress", (event) => head.advance(JSON.parse(event.data)));
    stream.addEventListener("stage_started", () => head.begin());
    stream.addEventListener("strategy_started", (event) => head.attempt(JSON.parse(event.data)));
    for (const kind of SEEN) {
      stream.addEventListener(kind, (event) => training.see(kind, JSON.parse(event.data)));
    }
    stream.onerror = () => {
      if (stream?.readyState !== EventSource.CLOSED) return;
      stream = null;
      if (!gone && !hasEnded) refresh();
    };
  }

  refresh();
  return () => {
    gone = true;
    clearTimeout(timer);
    stream?.close();
    head.leave();
    bar.leave();
    scene.leave();
    training.over();
    filmed.leave();
    log?.leave();
  };
}

const fileTable = (base, list) => h("table", {}, h("tbody", {}, list.map((file) => h("tr", {},
  h("td", {}, h("a", { href: `${base}/artifacts/${address(file.name)}`, download: file.name.split("/").pop() }, file.name)),
  h("td", { class: "number" }, size(file.bytes)),
  h("td", { class: "wide soft" }, `sha256 ${file.sha256.slice(0, 16)}…`)))));
