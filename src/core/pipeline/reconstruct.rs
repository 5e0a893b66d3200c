//! V_i: training from a checkpoint, the previous scene, or the sparse points.

mod checkpoint;
pub mod points;
mod watch;

use std::cell::RefCell;

use crate::device::Device;
use serde::{Deserialize, Serialize};

use super::config::{Options, Pace, Start};
use super::context::{Advance, Context};
use super::dependencies::Dependencies;
use super::error::PipelineError;
use super::minutes::RoundsLimit;
use super::round::Round;
use super::tone::Tone;
use super::training_images::TrainingImage;
use super::views::View;
use super::workspace::Workspace;
use crate::camera::{Camera, Split};
use crate::event::{Event, Stage};
use crate::gaussians::{Gaussians, ply};
use crate::image::Image;
use crate::metrics::report::{BetweenSteps, NoiseMapStatistics};
use crate::poses::Poses;
use crate::reconstruct::{
    self, Checkpoint, Look, Registration, Response, Seen, TrainConfig, TrainHooks, TrainStart,
    Trained, TrainingView,
};
use watch::{Watch, Watched};

/// V_i with the facts of its training, stored beside its `scene.ply`.
#[derive(Clone, Debug)]
pub struct TrainedScene {
    /// The Gaussians.
    pub gaussians: Gaussians,
    pub training: Training,
}

/// Facts of one training.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Training {
    /// Optimiser steps.
    pub steps: u64,
    /// Mean over the round.
    pub steps_per_second: f64,
    /// Seconds between the steps.
    #[serde(default)]
    pub between: Option<BetweenSteps>,
    /// Gradients dropped because they were not finite.
    pub non_finite_gradients: u64,
    /// Statistics of the learnt noise field.
    pub noise: Option<NoiseMapStatistics>,
    /// Standard deviation of the noise that the loss expected, mean over the training views whose
    /// noise is known; `None` if it expected none.
    #[serde(default)]
    pub expected_noise: Option<f64>,
    /// Training views with a kernel.
    #[serde(default)]
    pub kernels: u32,
    /// Their mean shake, px.
    pub shake_px: Option<f64>,
    /// Cameras of all views, in order.
    pub cameras: Vec<Camera>,
    /// Mean distance by which the camera corrections moved the middle of the images, px.
    pub pose_correction_px: Option<f64>,
    /// Most Gaussians, if that is fewer than the options say because the device ran out of memory.
    #[serde(default)]
    pub lowered_cap: Option<u64>,
}

impl Training {
    /// With the cameras in another world.
    fn with_cameras(self, moved: impl Fn(&Camera) -> Camera) -> Self {
        let cameras = self.cameras.iter().map(moved).collect();
        Self { cameras, ..self }
    }
}

/// The scene of the previous round, with the curve to this round's brightness.
#[derive(Clone, Copy, Debug)]
pub struct Predecessor<'a> {
    /// V_{i-1}.
    pub gaussians: &'a Gaussians,
    pub to_next: &'a Tone,
}

/// The inputs of a round's training.
pub struct TrainingData<'a> {
    /// The round, with its response from light to values.
    pub round: &'a Round,
    /// All views, with their cameras and splits.
    pub views: &'a [View],
    /// H_i, D_i or their mean (`train_on`), in the order of the views. Training takes them out.
    pub images: Vec<TrainingImage>,
    /// Which views have a kernel, in the same order.
    pub with_kernel: &'a [bool],
    /// H_i, for the live scores.
    pub enhanced: &'a [Image],
    /// The response from light to values at the target brightness, for the live scores.
    pub target: &'a Response,
    /// The sparse points.
    pub poses: &'a Poses,
    /// V_{i-1}, after the first round.
    pub before: Option<Predecessor<'a>>,
    /// The time limit, if there is one.
    pub limit: Option<RoundsLimit<'a>>,
}

/// Runs the stage: V_i, noise-aware splats of the training views, trained once.
///
/// # Errors
/// [`PipelineError::Reconstruct`], [`PipelineError::Ply`], [`PipelineError::Io`],
/// [`PipelineError::Cancelled`].
pub fn reconstruct(
    context: &mut Context<'_>,
    device: &Device,
    mut data: TrainingData<'_>,
    depends_on: &Dependencies,
) -> Result<TrainedScene, PipelineError> {
    let number = data.round.number;
    let folder = context.workspace.folder().round(number);
    let (scene_file, facts) = (folder.scene(), folder.training());
    let normalisation = &data.poses.normalisation;
    let load = |workspace: &Workspace| {
        let training: Training = workspace.read_json(&facts)?;
        let gaussians = ply::read(&scene_file).ok()?.gaussians;
        Some(TrainedScene {
            gaussians,
            training: training.with_cameras(|camera| normalisation.within(camera)),
        })
    };
    let mut is_trained = false;
    let make = |context: &mut Context<'_>| {
        let mut config = train_config(&data, depends_on.options());
        let asked = config.cap;
        let start = train_start(context, &data, &config, depends_on)?;
        let trained = train(context, device, &mut data, start, &mut config, depends_on)?;
        let mut scene = with_cameras(context, device, &mut data, trained, &config)?;
        scene.training.lowered_cap = (config.cap < asked).then_some(config.cap as u64);
        context.workspace.make_folder(folder.root())?;
        ply::write(&scene.gaussians, normalisation, &scene_file)?;
        let in_world = |camera: &Camera| normalisation.in_world(camera);
        let training = scene.training.clone().with_cameras(in_world);
        context.workspace.write_json(&facts, &training)?;
        is_trained = true;
        if normalisation.is_identity() {
            return Ok(scene);
        }
        // The files round it: a run that is resumed and one that is not go on with the same.
        Ok(TrainedScene {
            gaussians: ply::read(&scene_file)?.gaussians,
            training: training.with_cameras(|camera| normalisation.within(camera)),
        })
    };
    let scene = context.once(Stage::Reconstruct, number, depends_on, load, make)?;
    if is_trained {
        // It has served. That of a later round, which is to be resumed, stays.
        context.workspace.remove(&context.workspace.folder().work().checkpoint())?;
    }
    Ok(scene)
}

fn train_config(data: &TrainingData<'_>, options: &Options) -> TrainConfig {
    let round = data.round;
    let cameras: Vec<Camera> = data.views.iter().map(|view| view.camera).collect();
    let points = points::as_given(data.poses);
    let training = data.views.iter().zip(data.with_kernel);
    let shaken =
        training.filter(|(view, _)| view.split == Split::Train).any(|(_, has_kernel)| *has_kernel);
    let extent = match options.schedule {
        Pace::Adapted => reconstruct::scene_extent(&cameras, &points),
        Pace::Published => reconstruct::camera_extent(&training_cameras(data.views)),
    };
    TrainConfig {
        steps: options.steps_per_round(),
        cap: options.most_gaussians() as usize,
        sh_degree: options.sh_degree,
        noise: options.noise,
        shake: shaken.then(|| round.response.clone()),
        refine_poses: options.refine_poses.then(|| reconstruct::scene_depth(&cameras, &points)),
        resolution_schedule: options.schedule == Pace::Adapted,
        pace: options.schedule,
        warm: round.number > 1 && options.start == Start::Warm,
        background: options.background,
        densify: options.densify,
        seed: options.seed.wrapping_add(u64::from(round.number) << 32),
        extent,
    }
}

fn training_cameras(views: &[View]) -> Vec<Camera> {
    views.iter().filter(|view| view.split == Split::Train).map(|view| view.camera).collect()
}

/// Starts from the checkpoint of an interrupted training, the previous scene, or the points.
fn train_start(
    context: &mut Context<'_>,
    data: &TrainingData<'_>,
    config: &TrainConfig,
    depends_on: &Dependencies,
) -> Result<TrainStart, PipelineError> {
    if let Some(checkpoint) = checkpoint::read(context, data.round.number, depends_on) {
        return Ok(TrainStart::Resume(checkpoint));
    }
    let options = depends_on.options();
    if let (Start::Warm, Some(before)) = (options.start, data.before) {
        let mut gaussians = before.gaussians.clone();
        let curve = before.to_next.scene();
        gaussians.map_colours(|rgb| curve.apply_colour(rgb), |rgb| curve.slope(rgb));
        return Ok(TrainStart::Fresh(gaussians));
    }
    let cameras: Vec<Camera> = data.views.iter().map(|view| view.camera).collect();
    let pictures = data.views.iter().zip(&data.images);
    let training = pictures.filter(|(view, _)| view.split == Split::Train);
    let seen = training.map(|(view, seen)| (&view.camera, &seen.image, view.mask.as_ref()));
    let points = points::coloured(data.poses, seen);
    let (cap, schedule) = (config.cap, config.schedule());
    let first = reconstruct::initialise(&points, &cameras, cap, &schedule);
    Ok(TrainStart::Fresh(first))
}

/// Trains with the run's progress, cancellation and checkpoints.
fn train(
    context: &mut Context<'_>,
    device: &Device,
    data: &mut TrainingData<'_>,
    start: TrainStart,
    config: &mut TrainConfig,
    depends_on: &Dependencies,
) -> Result<Trained, PipelineError> {
    if let TrainStart::Resume(checkpoint) = &start {
        config.cap = config.cap.min(checkpoint.cap as usize);
    }
    let number = data.round.number;
    let views = training_views(data, Split::Train);
    let cancel = context.cancel;
    let work = context.workspace.folder().work();
    let picture = work.live_picture();
    let (watched, limit) = (watched(data), data.limit);
    // All hooks share one context; the trainer calls one at a time.
    let shared = RefCell::new(&mut *context);
    let mut progress = |done: u64, total: u64, rate: f64| {
        let progress = Advance { done, total, per_second: Some(rate) };
        shared.borrow_mut().advance(Stage::Reconstruct, number, progress);
    };
    let mut keep = |checkpoint: &Checkpoint| {
        keep_or_warn(&mut shared.borrow_mut(), number, checkpoint, depends_on);
    };
    let mut show = |seen: Seen| {
        let event = training_seen(number, seen);
        shared.borrow_mut().sink.event(&event);
    };
    let first_cap = config.cap;
    let mut attempt = |start: TrainStart, config: &TrainConfig| {
        // With fewer Gaussians than the file has: a kill must not bring back those without room.
        if let TrainStart::Resume(checkpoint) = &start
            && config.cap < first_cap
        {
            keep(checkpoint);
        }
        let mut watch = Watch::new(&watched);
        let mut pacing = limit.map(|limit| limit.pacing(number, config.steps));
        let mut look = |look: &mut Look<'_>| {
            let context = &mut *shared.borrow_mut();
            if let Some(pacing) = &mut pacing {
                pacing.look(look, context);
            }
            watch.look(look, context)
        };
        let mut hooks = TrainHooks {
            cancel,
            progress: &mut progress,
            checkpoint: Some(&mut keep),
            seen: Some(&mut show),
            look: Some(&mut look),
        };
        reconstruct::train(device, &views, start, config, &mut hooks)
    };
    let mut resume = |why: String| {
        let context = &mut *shared.borrow_mut();
        context.sink.warn("memory", format!("round {number}: {why}"));
        checkpoint::read(context, number, depends_on)
    };
    let trained = reconstruct::within_memory(device, start, config, &mut attempt, &mut resume);
    // The live picture is only for a scene in training.
    let removed = context.workspace.remove(&picture);
    let trained = trained?;
    removed?;
    for warning in &trained.warnings {
        let message = format!("round {number}: {warning}");
        context.sink.warn("training", message);
    }
    Ok(trained)
}

/// Keeps a checkpoint. A failure costs time after a crash, but does not end this run.
fn keep_or_warn(
    context: &mut Context<'_>,
    round: u32,
    checkpoint: &Checkpoint,
    depends_on: &Dependencies,
) {
    match checkpoint::keep(context.workspace, checkpoint, depends_on) {
        Ok(()) if context.cancel.is_cancelled() => {
            context.sink.log(format!("round {round}: stopped at step {}", checkpoint.step));
        }
        Ok(()) => {}
        Err(error) => context.sink.warn("checkpoint", format!("round {round}: {error}")),
    }
}

fn watched<'a>(data: &TrainingData<'a>) -> Watched<'a> {
    Watched { round: data.round, views: data.views, enhanced: data.enhanced, target: data.target }
}

fn training_seen(round: u32, seen: Seen) -> Event {
    Event::TrainingSeen {
        round,
        step: seen.step,
        steps: seen.steps,
        loss: seen.loss,
        gaussians: seen.gaussians as u64,
    }
}

/// The scene with the cameras of all views: those of training views as corrected in training, the
/// others registered to the scene.
fn with_cameras(
    context: &Context<'_>,
    device: &Device,
    data: &mut TrainingData<'_>,
    trained: Trained,
    config: &TrainConfig,
) -> Result<TrainedScene, PipelineError> {
    let held_out = training_views(data, Split::HeldOut);
    let registered = match config.refine_poses {
        Some(depth) if !held_out.is_empty() => {
            let shake = config.shake.as_ref();
            Registration::new(device, &held_out, &trained.gaussians, shake)?
                .cameras(depth, context.cancel)?
        }
        _ => held_out.iter().map(|view| view.camera).collect(),
    };
    let (mut corrected, mut registered) = (trained.cameras.iter(), registered.iter());
    let camera_after = |view: &View| {
        let found = match view.split {
            Split::Train => corrected.next(),
            Split::HeldOut => registered.next(),
        };
        *found.unwrap_or(&view.camera)
    };
    let cameras: Vec<Camera> = data.views.iter().map(camera_after).collect();
    let pose_correction_px = correction_px(data.views, &cameras, config.refine_poses);
    let seconds = trained.seconds.max(1e-9);
    let training = Training {
        steps: trained.steps,
        steps_per_second: trained.steps as f64 / seconds,
        between: Some(trained.between),
        non_finite_gradients: trained.non_finite_gradients,
        noise: trained.noise,
        expected_noise: trained.expected_noise,
        kernels: trained.kernels,
        shake_px: trained.shake_px,
        cameras,
        pose_correction_px,
        lowered_cap: None,
    };
    Ok(TrainedScene { gaussians: trained.gaussians, training })
}

/// The views of one split with their training images, which are moved.
fn training_views(data: &mut TrainingData<'_>, split: Split) -> Vec<TrainingView> {
    data.views
        .iter()
        .zip(&mut data.images)
        .zip(data.with_kernel)
        .filter(|((view, _), _)| view.split == split)
        .map(|((view, training), &has_kernel)| TrainingView {
            has_kernel,
            noise: training.noise,
            name: view.name.clone(),
            camera: view.camera,
            image: std::mem::replace(&mut training.image, Image::new(0, 0)),
            mask: view.mask.clone(),
        })
        .collect()
}

/// Mean distance by which a point at `depth` in the middle of each view moved, px.
fn correction_px(views: &[View], cameras: &[Camera], depth: Option<f64>) -> Option<f64> {
    let depth = depth?;
    let moved = views.iter().zip(cameras).filter_map(|(view, after)| {
        let before = view.camera;
        let point = before.centre() + depth * before.forward();
        Some((after.project(point)?.0 - before.project(point)?.0).length())
    });
    let moved: Vec<f64> = moved.collect();
    (!moved.is_empty()).then(|| moved.iter().sum::<f64>() / moved.len() as f64)
}
