//! Errors of a benchmark.

use fled_gpu::GpuError;

use super::options::MOST_STEPS;
use fled_core::cancel::Cancelled;
use fled_core::gaussians::ply::PlyError;
use fled_core::image::ImageError;
use fled_core::reconstruct::ReconstructError;
use fled_core::render::SplatError;

/// The reason why nothing was measured.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// A device error.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// Training failed.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// Rendering failed.
    #[error(transparent)]
    Render(#[from] SplatError),
    /// The caller cancelled the benchmark.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The scene of a finished run cannot be read.
    #[error(transparent)]
    Scene(#[from] PlyError),
    /// An image of a finished run cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The folder does not hold a finished run.
    #[error("{0}")]
    Run(String),
    /// A budget beyond [`MOST_STEPS`].
    #[error("{0} steps a case; at most {MOST_STEPS} are possible")]
    Steps(u32),
    /// There is nothing to measure.
    #[error("nothing to measure: no {0}")]
    Empty(&'static str),
}
