//! Errors of training a round.

use fled_gpu::GpuError;

use crate::cancel::Cancelled;

/// The reason why a round could not be trained.
#[derive(Debug, thiserror::Error)]
pub enum ReconstructError {
    /// A device error.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The caller cancelled training.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// Nothing to train on or from.
    #[error("there is nothing to train: {views} views, {gaussians} Gaussians")]
    Empty {
        /// Training views.
        views: usize,
        /// Gaussians at the start.
        gaussians: usize,
    },
    /// The checkpoint belongs to another round.
    #[error("the checkpoint belongs to another round or to other options")]
    OtherRound,
    /// The noise field refused its part of the checkpoint.
    #[error("noise field: {0}")]
    Noise(String),
    /// The optimisation diverged.
    #[error("{dropped} gradients were not finite by step {step}")]
    NotFinite {
        /// Number of dropped gradients.
        dropped: u64,
        /// Steps done by then.
        step: u32,
    },
}
