//! Why a round could not be trained.

use fled_gpu::GpuError;

use crate::cancel::Cancelled;

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
