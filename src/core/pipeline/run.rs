//! Algorithm 1.

use super::config::{Options, Setting};
use super::context::Context;
use super::deblur::{Blurred, deblur};
use super::deliver::{deliver, delivered};
use super::dependencies::{Levels, RoundDependencies, RunDependencies};
use super::enhance::{self, Brightening, enhance};
use super::error::PipelineError;
use super::evaluate::{Finished, RoundImages, evaluate};
use super::explained::{self, explained, trained_on, training_images};
use super::exposures::{self, Exposures};
use super::late_views::{FinishedRound, changed_views, late_views, with_fits};
use super::match_brightness::{Next, match_brightness};
use super::plan::{By, History, Plan, Teller};
use super::poses::{poses, publish};
use super::reconstruct::{Material, Predecessor, TrainedScene, reconstruct};
use super::render::render;
use super::report;
use super::shaken::{self, Shaken};
use super::tools::Tools;
use super::views::{self, View};
use super::workspace::Workspace;
use crate::cancel::CancelToken;
use crate::capture::{Capture, CaptureView};
use crate::event::{Event, ProgressSink};
use crate::image::Image;
use crate::metrics::{CaptureShake, Report};
use crate::poses::Poses;
use crate::poses::matching::Matching;

/// A finished run.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The content of `metrics.json`.
    pub report: Report,
}

/// The results that a round hands to the next.
struct Handover {
    /// P_R, H_{i+1} and HR.
    next: Next,
    /// V_i.
    scene: TrainedScene,
    /// The dependencies of the round's results.
    depends_on: RoundDependencies,
}

impl Handover {
    fn new(next: Next, scene: TrainedScene, depends_on: RoundDependencies) -> Self {
        Self { next, scene, depends_on }
    }

    fn guides(&self) -> &[Image] {
        &self.next.guides
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
    options: &Options,
    tools: &mut Tools<'_>,
    workspace: &Workspace,
    sink: &mut dyn ProgressSink,
    cancel: &CancelToken,
) -> Result<Outcome, PipelineError> {
    let sink = &mut teller(capture, options, tools, workspace, sink);
    let context = &mut begin(capture, options, tools, workspace, sink, cancel)?;
    let poses = poses(context, capture, options, tools)?.normalised();
    let depends_on = RunDependencies::of(options, capture, &poses, tools);
    let whole = depends_on.run();
    if let Some(report) = delivered(context, &whole)? {
        return Ok(Outcome { report });
    }
    publish(workspace, &poses)?;
    let mut report = report::begin(options, tools, depends_on.networks(), &poses);
    let mut views = views::load(context, capture, &poses, options)?;
    let (exposures, found) =
        exposures::find(context, tools.device, options, capture, &poses, &views)?;
    report.exposure = found;
    exposures.even(&mut views);
    let shaken = None;
    let asked = Asked { capture, options, shaken };
    let mut state = RoundState::new(context, asked, tools, poses, views, exposures)?;
    let on = &state.depends_on;
    let (views, brightening) = (&state.views, &state.brightening);
    let shaken = shaken::shaken(context, tools, options, views, brightening, on)?;
    report.shaken_views = shaken.as_ref().map(Shaken::count);
    report.capture_shake = shaken.as_ref().map(Shaken::verdict);
    let size = shaken.as_ref().map_or(options.longest_side(), |shaken| shaken.size(options));
    let in_effect = shaken::in_effect(options, report.capture_shake, size);
    report::change(&mut report, options, &in_effect);
    let asked = Asked { capture, options: &in_effect, shaken: shaken.as_ref() };
    let rounds = if asked.is_one_round() { 1 } else { options.round_count() };
    context.sink.event(&Event::Planned {
        rounds,
        views: state.views.len() as u32,
        shake: report.capture_shake,
        size: Some(in_effect.longest_side()),
    });
    let is_smaller = in_effect.longest_side() < options.longest_side();
    if is_smaller {
        state.views = views::load(context, capture, &state.poses, &in_effect)?;
        state.exposures.even(&mut state.views);
    }
    if asked.is_still() || is_smaller {
        let RoundState { poses, views, exposures, .. } = state;
        state = RoundState::new(context, asked, tools, poses, views, exposures)?;
    }
    let mut before: Option<Handover> = None;
    for index in 0..in_effect.round_count() as usize {
        let turn = Turn { asked, index, before: before.as_ref() };
        before = round(context, tools, turn, &mut state, &mut report)?;
        if before.is_none() {
            break;
        }
    }
    deliver(context, &mut report, &whole)?;
    Ok(Outcome { report })
}

/// The request: a capture, options, and the verdict on its shake.
#[derive(Clone, Copy)]
struct Asked<'a> {
    capture: &'a Capture,
    options: &'a Options,
    /// The views found shaken, if that decides anything.
    shaken: Option<&'a Shaken>,
}

impl Asked<'_> {
    /// Whether the rounds are plain splatting at the target brightness.
    fn is_still(&self) -> bool {
        self.shaken.map(Shaken::verdict) == Some(CaptureShake::Still)
    }

    /// Whether another round follows only if the previous one placed a photograph or showed that a
    /// view has a wrong pose.
    fn is_one_round(&self) -> bool {
        self.is_still() && self.options.rounds == Setting::Auto
    }
}

/// One round of a request, and the round before it.
#[derive(Clone, Copy)]
struct Turn<'a> {
    asked: Asked<'a>,
    /// 0-based.
    index: usize,
    before: Option<&'a Handover>,
}

/// Runs one round; returns the handover to the next, which may have another state.
#[expect(
    clippy::too_many_lines,
    reason = "a round of Algorithm 1, a call a stage: split it shows less"
)]
fn round(
    context: &mut Context<'_>,
    tools: &mut Tools<'_>,
    turn: Turn<'_>,
    state: &mut RoundState,
    report: &mut Report,
) -> Result<Option<Handover>, PipelineError> {
    let (asked, before) = (turn.asked, turn.before);
    let (poses, views, brightening) = (&state.poses, &mut state.views, &state.brightening);
    let round = &brightening.rounds[turn.index];
    let on = state.depends_on.round(round.number, before.map(|before| &before.depends_on));
    let brightened = before.map(|before| before.next.enhanced.clone());
    let enhanced = enhance(context, round, views, brightening, brightened)?; // H_i
    let blurred = Blurred {
        views,
        enhanced: &enhanced,
        guides: before.filter(|_| on.is_guided).map(Handover::guides), // HR
    };
    let deblurred = deblur(context, tools.deblurrer, round, blurred, &on.deblur)?; // D_i
    let known = report.rounds.last().map(|before| &before.views[..]);
    let explained = explained(asked.options, views, asked.shaken, known);
    let trained = trained_on(asked.options, round, views, &explained, [&enhanced, &deblurred]);
    explained::tell(context, round.number, views, &explained, &trained);
    let images = training_images(&trained, &enhanced, &deblurred, &round.response);
    let material = Material {
        round,
        views,
        images: &images,
        explained: &explained,
        enhanced: &enhanced,
        target: &brightening.last().response,
        poses,
        before: before.map(Handover::predecessor), // V_{i-1}
    };
    let scene = reconstruct(context, tools.device, &material, &on.reconstruct)?; // V_i
    let (cameras, by) = (&scene.training.cameras, &poses.normalisation);
    views::place(context, round.number, views, cameras, by)?;
    let renders = render(context, tools.device, round, views, &scene.gaussians)?; // R_i
    let next = if asked.is_one_round() {
        None
    } else {
        match_brightness(context, round, &renders, views, brightening, &on.matching)? // P_R
    };
    let finished = Finished {
        round,
        views,
        unregistered: &views::unregistered(asked.capture, poses),
        images: RoundImages::new(&enhanced, &deblurred, &renders),
        scene: &scene,
        next: next.as_ref(),
        normalisation: &poses.normalisation,
        deliver: asked.options.deliver,
    };
    let metrics = evaluate(context, &finished, brightening, &report.rounds)?;
    publish(context.workspace, &with_fits(poses, &metrics))?;
    report::add_round(context, report, metrics, asked.options.deliver)?;
    if turn.index + 1 == asked.options.round_count() as usize {
        return Ok(None);
    }
    let finished = FinishedRound {
        capture: asked.capture,
        poses,
        round,
        views,
        renders: &renders,
        scene: &scene,
        metrics: report.rounds.last().expect("the round was added"),
    };
    let Some((poses, mut views)) = join(context, asked, tools, &finished, &on, &state.depends_on)?
    else {
        return Ok(next.map(|next| Handover::new(next, scene, on)));
    };
    report::place(report, &poses);
    let exposures = &mut state.exposures;
    let late = exposures.even_late(tools.device, &scene.gaussians, &mut views, asked.capture)?;
    if let Some(found) = &mut report.exposure {
        found.views.extend(late);
    }
    let exposures = std::mem::take(exposures);
    context.sink.event(&Event::Planned {
        rounds: asked.options.round_count(),
        views: views.len() as u32,
        shake: report.capture_shake,
        size: Some(asked.options.longest_side()),
    });
    *state = RoundState::new(context, asked, tools, poses, views, exposures)?;
    state.hand_over(context, tools, turn.index, scene, on)
}

/// The poses and views of the next rounds, if the round's scene changes them.
fn join(
    context: &mut Context<'_>,
    asked: Asked<'_>,
    tools: &Tools<'_>,
    finished: &FinishedRound<'_>,
    on: &RoundDependencies,
    depends_on: &RunDependencies,
) -> Result<Option<(Poses, Vec<View>)>, PipelineError> {
    if !asked.options.late_views {
        return Ok(None);
    }
    let by = tools.matching.map(Matching::describe).unwrap_or_default();
    let on = on.late_views(depends_on, &by);
    let Some(poses) = late_views(context, tools, finished, &on)? else {
        return Ok(None);
    };
    let size = asked.options.longest_side() as usize;
    let views = changed_views(context, finished, &poses, size)?;
    Ok(Some((poses, views)))
}

impl RoundState {
    /// The inputs of rounds over these views.
    fn new(
        context: &mut Context<'_>,
        asked: Asked<'_>,
        tools: &mut Tools<'_>,
        poses: Poses,
        views: Vec<View>,
        exposures: Exposures,
    ) -> Result<Self, PipelineError> {
        let depends_on = RunDependencies::of(asked.options, asked.capture, &poses, tools);
        let depends_on =
            depends_on.with_levels(if asked.is_still() { Levels::Target } else { Levels::Rising });
        let brightening = enhance::plan(context, &views, &depends_on, tools)?;
        Ok(Self { poses, depends_on, views, brightening, exposures })
    }

    /// The handover to the next round, remade over these views.
    fn hand_over(
        &self,
        context: &mut Context<'_>,
        tools: &Tools<'_>,
        index: usize,
        scene: TrainedScene,
        on: RoundDependencies,
    ) -> Result<Option<Handover>, PipelineError> {
        let Self { views, brightening, .. } = self;
        let round = &brightening.rounds[index];
        let renders = render(context, tools.device, round, views, &scene.gaussians)?;
        let next = match_brightness(context, round, &renders, views, brightening, &on.matching)?;
        Ok(next.map(|next| Handover::new(next, scene, on)))
    }
}

/// Runs the stage of the poses alone; a run with the same workspace resumes there.
///
/// # Errors
/// [`PipelineError`].
pub fn find_poses(
    capture: &Capture,
    options: &Options,
    tools: &mut Tools<'_>,
    workspace: &Workspace,
    sink: &mut dyn ProgressSink,
    cancel: &CancelToken,
) -> Result<Poses, PipelineError> {
    let sink = &mut teller(capture, options, tools, workspace, sink);
    let context = &mut begin(capture, options, tools, workspace, sink, cancel)?;
    let poses = poses(context, capture, options, tools)?;
    publish(workspace, &poses)?;
    Ok(poses)
}

/// Writes the options of the run and reports its start.
fn begin<'a>(
    capture: &Capture,
    options: &Options,
    tools: &Tools<'_>,
    workspace: &'a Workspace,
    sink: &'a mut dyn ProgressSink,
    cancel: &'a CancelToken,
) -> Result<Context<'a>, PipelineError> {
    cancel.check()?;
    workspace.write_json(&workspace.folder().config(), options)?;
    sink.event(&Event::Planned {
        rounds: options.round_count(),
        views: capture.views.len() as u32,
        shake: None,
        size: None,
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

/// Adds progress and time left to the events of the run.
fn teller<'a>(
    capture: &Capture,
    options: &Options,
    tools: &Tools<'_>,
    workspace: &'a Workspace,
    sink: &'a mut dyn ProgressSink,
) -> Teller<'a> {
    let pixels = |view: &CaptureView| {
        let (width, height) =
            views::working_size(view.width, view.height, options.longest_side() as usize);
        width * height
    };
    let pixels = capture.views.iter().map(pixels).sum();
    let network = tools.networks().deblur;
    let by = By {
        adapter: tools.device.to_string(),
        network: format!("{} on {}", network.id, network.provider),
        poses: tools.sfm.describe(),
    };
    let history = History::open(tools.cache.as_deref(), workspace);
    let plan = Plan::new(options, capture.views.len(), pixels, by, history);
    Teller::new(sink, workspace, plan)
}
