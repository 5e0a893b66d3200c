//! Algorithm 1.

use super::config::{Guide, Options};
use super::context::Context;
use super::deblur::{Blurred, deblur};
use super::decide::decide;
use super::deliver::{deliver, delivered};
use super::dependencies::{RoundDependencies, RunDependencies};
use super::effective::Effective;
use super::enhance::{self, Brightening, enhance};
use super::error::PipelineError;
use super::evaluate::{Finished, RoundImages, evaluate};
use super::exposures::{self, Exposures};
use super::guide;
use super::late_views::{FinishedRound, changed_views, late_views, with_fits};
use super::match_brightness::{Next, match_brightness};
use super::minutes::RoundsLimit;
use super::plan::{Forecast, ProgressReporter, Rounds};
use super::poses::{poses, publish};
use super::reconstruct::{Predecessor, TrainedScene, TrainingData, reconstruct};
use super::render::render;
use super::report;
use super::restore::kept;
use super::shaken::{self, Shaken};
use super::tools::Tools;
use super::training_images::{self, trained_on, training_images};
use super::views::{self, View};
use super::workspace::Workspace;
use crate::cancel::CancelToken;
use crate::capture::Capture;
use crate::event::{Event, ProgressSink};
use crate::image::Image;
use crate::metrics::{CaptureShake, Report};
use crate::poses::matching::Matching;
use crate::poses::{PosedView, Poses};
use crate::run_folder::KeptImages;

/// A finished run.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The content of `metrics.json`.
    pub report: Report,
}

/// The results of a round that the next one uses.
struct RoundOutput {
    /// P_R and H_{i+1}.
    next: Next,
    /// R_i, of which HR is made.
    renders: Vec<Image>,
    /// V_i.
    scene: TrainedScene,
    /// The dependencies of the round's results.
    depends_on: RoundDependencies,
}

impl RoundOutput {
    /// HR, if the round is guided. Only deblurring reads it or the renders, which are a picture a
    /// view that training would keep in memory.
    fn take_guides(&mut self, how: Guide, is_guided: bool) -> Option<Vec<Image>> {
        let renders = std::mem::take(&mut self.renders);
        is_guided.then(|| guide::guides(how, &self.next, renders))
    }

    fn predecessor(&self) -> Predecessor<'_> {
        Predecessor { gaussians: &self.scene.gaussians, to_next: &self.next.to_next }
    }
}

/// The inputs of the rounds; late views change them between rounds.
struct RoundState {
    poses: Poses,
    depends_on: RunDependencies,
    /// L.
    views: Vec<View>,
    /// P_1..P_N, H_N.
    brightening: Brightening,
    exposures: Exposures,
}

/// Runs Algorithm 1: brighten one step, deblur, train, render; the clean renders guide the next
/// round. Symbols as in the paper: L dark views, P anchors, H enhanced, D deblurred, V scene, R
/// renders, HR guides.
///
/// # Errors
/// [`PipelineError`]; finished stages stay in the workspace and are not repeated.
pub fn run(
    capture: &Capture,
    asked: &Options,
    tools: &mut Tools<'_>,
    workspace: &Workspace,
    sink: &mut dyn ProgressSink,
    cancel: &CancelToken,
) -> Result<Outcome, PipelineError> {
    let forecast = Forecast::new(capture, tools, workspace);
    let mut decision = decide(capture, asked, tools.device, &forecast, workspace)?;
    let options = &decision.options;
    let sink = &mut ProgressReporter::new(sink, workspace, forecast.plan(options));
    let context = &mut begin(capture, asked, tools, workspace, sink, cancel)?;
    decision.report(context);
    let poses = poses(context, capture, options, tools)?.normalised();
    let depends_on = RunDependencies::of(options, capture, &poses, tools);
    let whole = depends_on.run();
    if let Some(report) = delivered(context, &whole)? {
        return Ok(Outcome { report });
    }
    publish(workspace, &poses)?;
    let mut report = report::begin(&decision, tools, depends_on.networks(), &poses);
    let mut views = views::load(context, capture, &poses, options)?;
    let (exposures, found) =
        exposures::find(context, tools.device, options, capture, &poses, &views)?;
    report.exposure = found;
    exposures.even(&mut views);
    let before_verdict = Effective::of(options, None);
    let request = Request { capture, effective: &before_verdict, limit: None };
    let mut state = RoundState::new(context, request, tools, poses, views, exposures)?;
    let on = &state.depends_on;
    let (views, brightening) = (&state.views, &state.brightening);
    let shaken = shaken::shaken(context, tools, options, views, brightening, on)?;
    report.shaken_views = shaken.as_ref().map(Shaken::count);
    report.capture_shake = shaken.as_ref().map(Shaken::verdict);
    let mut effective = Effective::of(options, shaken.as_ref());
    let rounds = rounds(&effective, &state.views, report.capture_shake);
    if let Some(time) = &mut decision.time {
        let seconds = time.refill(context, &mut effective.options, rounds, &forecast)?;
        report.expected_seconds = Some(seconds);
    }
    let effective = &effective;
    let in_effect = &effective.options;
    report::change(&mut report, asked, in_effect);
    let limit = decision.time.as_ref();
    let limit = limit.map(|time| time.of_rounds(&forecast, in_effect, rounds));
    let request = Request { capture, effective, limit };
    context.sink.event(&planned(rounds, in_effect));
    let is_smaller = in_effect.longest_side() < options.longest_side();
    if is_smaller {
        state.views = views::load(context, capture, &state.poses, in_effect)?;
        state.exposures.even(&mut state.views);
    }
    if effective.levels != before_verdict.levels || effective.options != before_verdict.options {
        let RoundState { poses, views, exposures, .. } = state;
        state = RoundState::new(context, request, tools, poses, views, exposures)?;
    }
    let mut before: Option<RoundOutput> = None;
    for index in 0..in_effect.round_count() as usize {
        let input = RoundInput { request, index, before };
        before = round(context, tools, input, &mut state, &mut report)?;
        if before.is_none() {
            break;
        }
    }
    deliver(context, &mut report, &whole)?;
    Ok(Outcome { report })
}

/// The rounds as decided, over these views.
fn rounds(effective: &Effective, views: &[View], shake: Option<CaptureShake>) -> Rounds {
    Rounds {
        rounds: effective.rounds(),
        views: views.len() as u32,
        shake,
        size: views::longest_side(views).min(effective.options.longest_side()),
    }
}

fn planned(rounds: Rounds, options: &Options) -> Event {
    let Rounds { rounds, views, shake, size } = rounds;
    let steps = Some(options.steps_per_round());
    Event::Planned { rounds, views, shake, size: Some(size), steps }
}

/// A capture, and what its rounds do.
#[derive(Clone, Copy)]
struct Request<'a> {
    capture: &'a Capture,
    effective: &'a Effective,
    /// The time limit, if there is one.
    limit: Option<RoundsLimit<'a>>,
}

/// One round of a request, and the round before it.
struct RoundInput<'a> {
    request: Request<'a>,
    /// 0-based.
    index: usize,
    before: Option<RoundOutput>,
}

/// Runs one round; returns its results for the next, which may have another state.
#[expect(
    clippy::too_many_lines,
    reason = "a round of Algorithm 1, a call a stage: split it shows less"
)]
fn round(
    context: &mut Context<'_>,
    tools: &mut Tools<'_>,
    input: RoundInput<'_>,
    state: &mut RoundState,
    report: &mut Report,
) -> Result<Option<RoundOutput>, PipelineError> {
    let (request, mut before) = (input.request, input.before);
    let (capture, effective) = (request.capture, request.effective);
    let options = &effective.options;
    let (poses, views, brightening) = (&state.poses, &mut state.views, &state.brightening);
    let round = &brightening.rounds[input.index];
    let on = state.depends_on.round(round.number, before.as_ref().map(|before| &before.depends_on));
    let brightened = before.as_ref().map(|before| before.next.enhanced.clone());
    let guides = before.as_mut().and_then(|before| before.take_guides(options.guide, on.is_guided));
    let enhanced = enhance(context, round, views, brightening, brightened)?; // H_i
    let blurred = Blurred {
        views,
        enhanced: &enhanced,
        guides: guides.as_deref(), // HR
    };
    let deblurred = deblur(context, tools.deblurrer, round, blurred, &on.deblur)?; // D_i
    drop(guides);
    let known = report.rounds.last().map(|before| &before.views[..]);
    let with_kernel = effective.kernels(views, known);
    let trained = trained_on(options, round, views, &with_kernel, [&enhanced, &deblurred]);
    training_images::report(context, round.number, views, &with_kernel, &trained);
    let images = training_images(options, &trained, [&enhanced, &deblurred], &round.response);
    drop(deblurred); // Training has its own: a picture a view that it would keep in memory.
    let data = TrainingData {
        round,
        views,
        images,
        with_kernel: &with_kernel,
        enhanced: &enhanced,
        target: &brightening.last().response,
        poses,
        before: before.as_ref().map(RoundOutput::predecessor), // V_{i-1}
        limit: request.limit.map(|limit| limit.now(input.index, effective, views)),
    };
    let scene = reconstruct(context, tools.device, data, &on.reconstruct)?; // V_i
    let (cameras, by) = (&scene.training.cameras, &poses.normalisation);
    views::place(context, round.number, views, cameras, by)?;
    let renders = render(context, tools.device, round, views, &scene.gaussians)?; // R_i
    let next = if effective.is_single {
        None
    } else {
        match_brightness(context, round, &renders, views, brightening, &on.matching)? // P_R
    };
    let deblurred = kept(context.workspace, KeptImages::Deblurred, round.number, views)?;
    let finished = Finished {
        round,
        views,
        unregistered: &views::unregistered(capture, poses),
        images: RoundImages::new(&enhanced, &deblurred, &renders),
        scene: &scene,
        next: next.as_ref(),
        normalisation: &poses.normalisation,
        deliver: options.deliver,
    };
    let metrics = evaluate(context, &finished, brightening, &report.rounds)?;
    publish(context.workspace, &with_fits(poses, &metrics))?;
    report::add_round(context, report, metrics, options.deliver)?;
    if input.index + 1 == options.round_count() as usize {
        return Ok(None);
    }
    let finished = FinishedRound {
        capture,
        poses,
        round,
        views,
        renders: &renders,
        scene: &scene,
        metrics: report.rounds.last().expect("the round was added"),
    };
    let Some((poses, mut views)) =
        join(context, options, tools, &finished, &on, &state.depends_on)?
    else {
        return Ok(next.map(|next| RoundOutput { next, renders, scene, depends_on: on }));
    };
    report::place(report, &poses);
    let exposures = &mut state.exposures;
    let is_new = |posed: &&PosedView| !state.poses.views.contains(posed);
    poses.views.iter().filter(is_new).for_each(|posed| exposures.forget(&posed.name));
    let late = exposures.even_late(tools.device, &scene.gaussians, &mut views, capture)?;
    if let Some(found) = &mut report.exposure {
        found.views.extend(late);
    }
    let exposures = std::mem::take(exposures);
    let rounds =
        Rounds { rounds: options.round_count(), ..rounds(effective, &views, report.capture_shake) };
    context.sink.event(&planned(rounds, options));
    *state = RoundState::new(context, request, tools, poses, views, exposures)?;
    state.output(context, tools, input.index, scene, on)
}

/// The poses and views of the next rounds, if the round's scene changes them.
fn join(
    context: &mut Context<'_>,
    options: &Options,
    tools: &Tools<'_>,
    finished: &FinishedRound<'_>,
    on: &RoundDependencies,
    depends_on: &RunDependencies,
) -> Result<Option<(Poses, Vec<View>)>, PipelineError> {
    if !options.late_views {
        return Ok(None);
    }
    let by = tools.matching.map(Matching::describe).unwrap_or_default();
    let on = on.late_views(depends_on, &by);
    let Some(poses) = late_views(context, tools, finished, &on)? else {
        return Ok(None);
    };
    let size = options.longest_side() as usize;
    let views = changed_views(context, finished, &poses, size)?;
    Ok(Some((poses, views)))
}

impl RoundState {
    /// The inputs of rounds over these views.
    fn new(
        context: &mut Context<'_>,
        request: Request<'_>,
        tools: &mut Tools<'_>,
        poses: Poses,
        views: Vec<View>,
        exposures: Exposures,
    ) -> Result<Self, PipelineError> {
        let Request { capture, effective, .. } = request;
        let depends_on = RunDependencies::of(&effective.options, capture, &poses, tools);
        let depends_on = depends_on.with_levels(effective.levels);
        let brightening = enhance::plan(context, &views, &depends_on, tools)?;
        Ok(Self { poses, depends_on, views, brightening, exposures })
    }

    /// The results of a round, made again over these views.
    fn output(
        &self,
        context: &mut Context<'_>,
        tools: &Tools<'_>,
        index: usize,
        scene: TrainedScene,
        on: RoundDependencies,
    ) -> Result<Option<RoundOutput>, PipelineError> {
        let Self { views, brightening, .. } = self;
        let round = &brightening.rounds[index];
        let renders = render(context, tools.device, round, views, &scene.gaussians)?;
        let next = match_brightness(context, round, &renders, views, brightening, &on.matching)?;
        Ok(next.map(|next| RoundOutput { next, renders, scene, depends_on: on }))
    }
}

/// Runs the stage of the poses alone; a run with the same workspace resumes there.
///
/// # Errors
/// [`PipelineError`].
pub fn find_poses(
    capture: &Capture,
    asked: &Options,
    tools: &mut Tools<'_>,
    workspace: &Workspace,
    sink: &mut dyn ProgressSink,
    cancel: &CancelToken,
) -> Result<Poses, PipelineError> {
    // Poses depend neither on the detail nor on what fits into memory, which the run decides.
    let plan = Forecast::new(capture, tools, workspace).plan(asked);
    let sink = &mut ProgressReporter::new(sink, workspace, plan);
    let context = &mut begin(capture, asked, tools, workspace, sink, cancel)?;
    let poses = poses(context, capture, asked, tools)?;
    publish(workspace, &poses)?;
    Ok(poses)
}

/// Writes the options of the run and reports its start.
fn begin<'a>(
    capture: &Capture,
    asked: &Options,
    tools: &Tools<'_>,
    workspace: &'a Workspace,
    sink: &'a mut dyn ProgressSink,
    cancel: &'a CancelToken,
) -> Result<Context<'a>, PipelineError> {
    cancel.check()?;
    workspace.write_json(&workspace.folder().config(), asked)?;
    if workspace.enter()? {
        let message = "another version of fled began this run; its stages start again";
        sink.warn("upgraded", message.to_owned());
    }
    sink.event(&Event::Planned {
        rounds: asked.round_count(),
        views: capture.views.len() as u32,
        shake: None,
        size: None,
        steps: None,
    });
    sink.log(format!("adapter: {}", tools.device));
    for (option, network) in tools.networks().named() {
        sink.log(format!("{option}: {} on {}", network.id, network.provider));
    }
    for fallback in &tools.fallbacks {
        sink.warn("fallback", fallback.clone());
    }
    Ok(Context::new(workspace, sink, cancel))
}
