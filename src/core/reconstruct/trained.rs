//! What a round leaves.

use crate::camera::Camera;
use crate::gaussians::Gaussians;
use crate::metrics::report::NoiseMapStatistics;

/// A trained round.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The scene. Gaussians that are not finite are left out.
    pub gaussians: Gaussians,
    /// Optimiser steps of the round.
    pub steps: u64,
    /// Wall seconds of all processes that trained it, as far as checkpoints tell.
    pub seconds: f64,
    /// Gradients that were not finite and were dropped.
    pub non_finite_gradients: u64,
    /// What the noise field learnt; `None` when it was off.
    pub noise: Option<NoiseMapStatistics>,
    /// Mean [`ShakeKernel::spread`](crate::shake::ShakeKernel::spread) over the views, px; `None`
    /// when shake was off.
    pub shake_px: Option<f64>,
    /// Views with a kernel.
    pub kernels: u32,
    /// The views' cameras, in their order, corrected or as given.
    pub cameras: Vec<Camera>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Loss of the last step.
    pub final_loss: f64,
}
