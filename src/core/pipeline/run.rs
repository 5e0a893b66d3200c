//! Algorithm 1.

use super::config::Options;
use super::context::Context;
use super::deblur::{Blurred, deblur};
use super::deliver::{deliver, delivered};
use super::dependencies::{RoundDependencies, RunDependencies};
use super::enhance::{self, enhance};
use super::error::PipelineError;
use super::evaluate::{Finished, RoundImages, evaluate};
use super::match_brightness::{Next, match_brightness};
use super::plan::Plan;
use super::poses::poses;
use super::reconstruct::{Material, Predecessor, TrainedScene, reconstruct};
use super::render::render;
use super::report;
use super::tools::Tools;
use super::views;
use super::workspace::Workspace;
use crate::cancel::CancelToken;
use crate::capture::Capture;
use crate::event::{Event, ProgressSink};
use crate::image::Image;
use crate::metrics::Report;
use crate::poses::Poses;

/// A finished run.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// What stands in `metrics.json`.
    pub report: Report,
}

/// What a round hands to the next.
struct Handover {
    /// P_R, H_{i+1} and HR.
    next: Next,
    /// V_i.
    scene: TrainedScene,
    /// What the round's results depend on.
    depends_on: RoundDependencies,
}

impl Handover {
    fn new(next: Next, scene: TrainedScene, depends_on: RoundDependencies) -> Self {
        Self {
            next,
            scene,
            depends_on,
        }
    }

    fn guides(&self) -> &[Image] {
        &self.next.guides
    }

    fn predecessor(&self) -> Predecessor<'_> {
        Predecessor {
            gaussians: &self.scene.gaussians,
            to_next: &self.next.to_next,
        }
    }
}

/// Algorithm 1: brighten one step, deblur, train, render; let the clean renders guide the next
/// round. Symbols as in the paper: L dark views, P anchors, H enhanced, D deblurred, V scene,
/// R renders, HR guides.
///
/// # Errors
/// [`PipelineError`]; what was finished stays in the workspace and is not done again.
pub fn run(
    capture: &Capture,
    options: &Options,
    tools: &mut Tools<'_>,
    workspace: &Workspace,
    sink: &mut dyn ProgressSink,
    cancel: &CancelToken,
) -> Result<Outcome, PipelineError> {
    let context = &mut begin(capture, options, tools, workspace, sink, cancel)?;
    let poses = poses(context, capture, options, tools)?;
    let depends_on = RunDependencies::of(options, capture, &poses, tools);
    if let Some(report) = delivered(context, &depends_on.run())? {
        return Ok(Outcome { report });
    }
    let unregistered = views::unregistered(capture, &poses);
    let mut report = report::begin(options, tools, depends_on.networks(), &poses);
    let mut views = views::load(context, capture, &poses, options)?; // L
    let brightening = enhance::plan(context, &views, &depends_on, tools)?; // P_1..P_N, H_N
    let mut before: Option<Handover> = None;
    for round in &brightening.rounds {
        let before_it = before.as_ref();
        let on = depends_on.round(round.number, before_it.map(|before| &before.depends_on));
        let brightened = before_it.map(|before| before.next.enhanced.clone());
        let enhanced = enhance(context, round, &views, &brightening, brightened)?; // H_i
        let blurred = Blurred {
            views: &views,
            enhanced: &enhanced,
            guides: before_it.filter(|_| on.is_guided).map(Handover::guides), // HR
        };
        let deblurred = deblur(context, tools.deblurrer, round, blurred, &on.deblur)?; // D_i
        let material = Material {
            round,
            views: &views,
            images: options.trained_on(&enhanced[..], &deblurred),
            poses: &poses,
            before: before_it.map(Handover::predecessor), // V_{i-1}
        };
        let scene = reconstruct(context, tools.gpu, &material, &on.reconstruct)?; // V_i
        views::place(context, &mut views, &scene.training.cameras)?;
        let renders = render(context, tools.gpu, round, &views, &scene.gaussians)?; // R_i
        let fit = on.matching.options();
        let next = match_brightness(context, round, &renders, &views, &brightening, fit)?; // P_R
        let finished = Finished {
            round,
            views: &views,
            unregistered: &unregistered,
            images: RoundImages::new(&enhanced, &deblurred, &renders),
            scene: &scene,
            next: next.as_ref(),
        };
        let metrics = evaluate(context, &finished, &brightening, report.rounds.last())?;
        report::add_round(context, &mut report, metrics)?;
        before = next.map(|next| Handover::new(next, scene, on));
    }
    deliver(context, &mut report, &views, &depends_on.run())?;
    Ok(Outcome { report })
}

/// The stage of the poses alone; a run with the same workspace goes on from there.
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
    let context = &mut begin(capture, options, tools, workspace, sink, cancel)?;
    poses(context, capture, options, tools)
}

/// Writes the options as run and tells what is about to happen, with what.
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
    let views = capture.views.len();
    let pixels = capture.views.first().map_or(0, |view| {
        let size = options.size as usize;
        let (width, height) = views::working_size(view.width, view.height, size);
        width * height
    });
    sink.event(&Event::Planned {
        rounds: options.rounds,
        views: views as u32,
    });
    sink.log(format!("adapter: {}", tools.gpu.describe()));
    for (option, network) in tools.networks().named() {
        sink.log(format!("{option}: {} on {}", network.id, network.provider));
    }
    let trained_on = if options.trains_on_enhanced() {
        "enhanced"
    } else {
        "deblurred"
    };
    sink.log(format!("the scene is trained on the {trained_on} views"));
    for fallback in &tools.fallbacks {
        sink.warn("fallback", fallback.clone());
    }
    let plan = Plan::new(options, views, pixels);
    Ok(Context::new(workspace, sink, cancel, plan))
}
