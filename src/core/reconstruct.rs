//! Training the splats of one round: from posed views to a scene.
//!
//! A step is one submission: project, sort, blend, noise, loss, and all the way back into Adam. The
//! host waits for nothing but the count of intersections of the step before last.

pub mod checkpoint;
mod colour;
pub mod densify;
mod forward_model;
pub mod initialise;
mod level;
pub mod loss;
mod observed;
pub mod optimizer;
mod registration;
pub mod schedule;
mod trainer;

use fled_gpu::{Gpu, GpuError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::cancel::{CancelToken, Cancelled};
use crate::gaussians::Gaussians;
use crate::image::Image;
use crate::metrics::report::NoiseMapStatistics;
use crate::noise::NoiseMode;
pub use crate::shake::Response;
pub use checkpoint::{Checkpoint, CheckpointError};
pub use initialise::{Beginning, Point, initialise, scene_depth, scene_extent};
pub use registration::Registration;
pub use schedule::Schedule;
pub use trainer::Stepper;

/// One image to train on.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// For messages.
    pub name: String,
    /// Its camera, at the size of the image.
    pub camera: Camera,
    /// sRGB-encoded.
    pub image: Image,
    /// Its measured noise, 0..=1; bounds the noise field.
    pub noise_sigma: f32,
}

/// What training renders the splats before. Delivered views have a black background.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// Black: what is dark in every view may turn transparent.
    Black,
    /// Another colour at every step, so that only what is opaque looks right. Differs from the
    /// paper: its views fill their frames too, and what is seen through from elsewhere is a hole.
    Random,
}

/// How Gaussians come and go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Densify {
    /// MCMC: relocation and growth up to the cap.
    Mcmc,
    /// Clone, split and prune by gradients, as first published; at most the cap.
    Classic,
    /// No change of the number of Gaussians.
    Off,
}

/// The length that rates and noise are measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExtentRule {
    /// The larger of the cameras' own and a quarter of the points' median depth: cameras that face
    /// forward stand close together.
    Scene,
    /// 1.1 times the radius of the cameras, as first published.
    Cameras,
}

/// Where a round begins.
#[derive(Clone, Debug)]
pub enum TrainStart {
    /// From these Gaussians: [`initialise`]d, or those of the round before.
    Fresh(Gaussians),
    /// From the middle of the same round.
    Resume(Checkpoint),
}

/// What a round is trained with.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainConfig {
    /// Optimiser steps.
    pub steps: u32,
    /// Explain the shake of the views, whose values come from light like this; `None`: they are not
    /// shaken.
    pub shake: Option<Response>,
    /// Correct the cameras by the renders. The number is about how far away the scene is, world
    /// units; `None`: they stand where the poses say.
    pub refine_poses: Option<f64>,
    /// Most Gaussians.
    pub cap: usize,
    /// Degree of the harmonics.
    pub sh_degree: u32,
    /// The noise field.
    pub noise: NoiseMode,
    /// Train at 1/4, 1/2, then full resolution.
    pub resolution_schedule: bool,
    /// Whether the round starts from a trained scene.
    pub warm: bool,
    /// What lies behind the splats.
    pub background: Background,
    /// Share of the Gaussians that a step at the end of the round goes without; it grows from
    /// nothing. Against floaters that only few views see.
    pub dropout: f64,
    /// How Gaussians come and go.
    pub densify: Densify,
    /// Take differences of exposure and cast between the views out of their images.
    pub view_colour: bool,
    /// Seed of everything random.
    pub seed: u64,
    /// [`scene_extent`], world units.
    pub extent: f64,
}

impl TrainConfig {
    /// What changes over the round.
    pub fn schedule(&self) -> Schedule {
        Schedule {
            steps: self.steps,
            sh_degree: self.sh_degree,
            resolution: self.resolution_schedule,
            warm: self.warm,
            seed: self.seed,
        }
    }
}

/// Takes done steps, all steps and steps per second.
pub type ProgressHook<'a> = &'a mut dyn FnMut(u64, u64, f64);
/// Takes a checkpoint, at least once a minute.
pub type CheckpointHook<'a> = &'a mut dyn FnMut(&Checkpoint);

/// Whom a round tells, and who may stop it.
pub struct TrainHooks<'a> {
    /// Checked between submissions.
    pub cancel: &'a CancelToken,
    /// About four times a second.
    pub progress: ProgressHook<'a>,
    /// `None`: no checkpoints are made.
    pub checkpoint: Option<CheckpointHook<'a>>,
}

/// A trained round.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The scene. Gaussians that are not finite are left out.
    pub gaussians: Gaussians,
    /// Optimiser steps of the round.
    pub steps: u64,
    /// Wall seconds of this process.
    pub seconds: f64,
    /// Gradients that were not finite and were dropped.
    pub non_finite_gradients: u64,
    /// What the noise field learnt; `None` when it was off.
    pub noise: Option<NoiseMapStatistics>,
    /// Mean [`ShakeKernel::spread`](crate::shake::ShakeKernel::spread) over the views, px; `None`
    /// when shake was off.
    pub shake_px: Option<f64>,
    /// The views' cameras, in their order, corrected or as given.
    pub cameras: Vec<Camera>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Loss of the last step.
    pub final_loss: f64,
}

/// A round that could not be trained.
#[derive(Debug, thiserror::Error)]
pub enum ReconstructError {
    /// The device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// Asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// Nothing to train on or from.
    #[error("nothing to train: {views} views, {gaussians} Gaussians")]
    Empty {
        /// Training views.
        views: usize,
        /// Gaussians at the start.
        gaussians: usize,
    },
    /// The checkpoint is another round's.
    #[error("the checkpoint belongs to another round or other options")]
    OtherRound,
    /// The noise field refused its part of the checkpoint.
    #[error("noise field: {0}")]
    Noise(String),
    /// The optimisation diverged.
    #[error("{dropped} gradients were not finite by step {step}")]
    NotFinite {
        /// How many were dropped.
        dropped: u64,
        /// Up to which step.
        step: u32,
    },
}

/// Trains one round.
///
/// Same seed, same device: the same bits, with or without interruption.
///
/// # Errors
/// [`ReconstructError`].
pub fn train(
    gpu: &Gpu,
    views: &[TrainingView],
    start: TrainStart,
    config: &TrainConfig,
    hooks: &mut TrainHooks<'_>,
) -> Result<Trained, ReconstructError> {
    trainer::Trainer::new(gpu, views, start, config)?.run(hooks)
}

#[cfg(test)]
mod tests;
