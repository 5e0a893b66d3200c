//! The inputs and results of a training round.

use fled_gpu::GpuError;

use super::checkpoint::Checkpoint;
use super::look::Look;
use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::gaussians::Gaussians;
use crate::image::Image;
use crate::mask::Mask;
use crate::metrics::report::{BetweenSteps, NoiseMapStatistics};
use crate::noise_levels::NoiseLevels;

/// One training image.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// Name for messages.
    pub name: String,
    /// Its camera, at the size of the image.
    pub camera: Camera,
    /// sRGB-encoded.
    pub image: Image,
    /// The pixels that count; all without one.
    pub mask: Option<Mask>,
    /// The noise of the image; none is assumed without it.
    pub noise: Option<NoiseLevels>,
    /// Whether a kernel may explain its shake, if the round has kernels.
    pub has_kernel: bool,
}

/// The start of a round.
#[derive(Clone, Debug)]
pub enum TrainStart {
    /// From these Gaussians: [`initialise`](super::initialise())d, or those of the previous round.
    Fresh(Gaussians),
    /// From a checkpoint of the same round.
    Resume(Checkpoint),
}

/// Receives done steps, all steps and steps per second.
pub type ProgressHook<'a> = &'a mut dyn FnMut(u64, u64, f64);
/// Receives a checkpoint: about every 30 seconds, and when the round is cancelled.
pub type CheckpointHook<'a> = &'a mut dyn FnMut(&Checkpoint);
/// Receives the state of training every 25 steps, every 100 of a round of 5,000 and more.
pub type SeenHook<'a> = &'a mut dyn FnMut(Seen);
/// May render the current scene, and change the number of steps: about as often, and after the
/// last.
pub type LookHook<'a> = &'a mut dyn FnMut(&mut Look<'_>) -> Result<(), GpuError>;

/// The state of training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Steps done.
    pub step: u32,
    /// Steps of the round.
    pub steps: u32,
    /// Loss of the last step's view; it scatters, because views differ.
    pub loss: f64,
    /// Gaussians of the scene.
    pub gaussians: usize,
}

/// The callbacks of a training round.
pub struct TrainHooks<'a> {
    /// Checked between submissions. The running step is finished, and the checkpoint hook, if any,
    /// receives the state after it.
    pub cancel: &'a CancelToken,
    /// Called about four times a second.
    pub progress: ProgressHook<'a>,
    /// `None` makes no checkpoints.
    pub checkpoint: Option<CheckpointHook<'a>>,
    pub seen: Option<SeenHook<'a>>,
    /// `None` renders nothing. Training is the same either way, unless it changes the steps.
    pub look: Option<LookHook<'a>>,
}

/// A trained round.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The scene, without Gaussians that are not finite.
    pub gaussians: Gaussians,
    /// Optimiser steps of the round.
    pub steps: u64,
    /// Wall seconds of training in all processes, as recorded in checkpoints.
    pub seconds: f64,
    /// Seconds between the steps, in this process.
    pub between: BetweenSteps,
    /// Gradients dropped because they were not finite.
    pub non_finite_gradients: u64,
    /// Statistics of the learnt noise field; `None` without one.
    pub noise: Option<NoiseMapStatistics>,
    /// Standard deviation of the noise that the loss expected, mean over the views whose noise is
    /// known; `None` if it expected none.
    pub expected_noise: Option<f64>,
    /// Mean [`ShakeKernel::spread`](crate::shake::ShakeKernel::spread) over the views, px; `None`
    /// without shake.
    pub shake_px: Option<f64>,
    /// Views with a kernel.
    pub kernels: u32,
    /// The views' cameras, in their order, corrected or as given.
    pub cameras: Vec<Camera>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
    /// Loss of the last step.
    pub final_loss: f64,
}
