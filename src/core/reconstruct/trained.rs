//! The result of a round.

use crate::camera::Camera;
use crate::gaussians::Gaussians;
use crate::metrics::report::{BetweenSteps, NoiseMapStatistics};

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
