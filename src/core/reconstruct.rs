//! Training the splats of one round: from posed views to a scene.
//!
//! A step is one submission: project, sort, blend, noise, loss, and the way back to Adam. The host
//! waits only for the number of intersections of the step before last.

pub mod checkpoint;
mod config;
pub mod densify;
mod error;
mod forward_model;
pub mod initialise;
mod level;
mod look;
pub mod loss;
mod observed;
pub mod optimizer;
mod registration;
mod round;
pub mod schedule;
mod trainer;

use fled_gpu::Gpu;

pub use crate::shake::Response;
pub use checkpoint::{Checkpoint, CheckpointError};
pub use config::{Background, Densify, Pace, TrainConfig};
pub use error::ReconstructError;
pub use initialise::{Point, camera_extent, initialise, scene_depth, scene_extent};
pub use look::Look;
pub use registration::{CORRECTIONS, Registration};
pub use round::{
    CheckpointHook, LookHook, ProgressHook, Seen, SeenHook, TrainHooks, TrainStart, Trained,
    TrainingView,
};
pub use schedule::Schedule;
pub use trainer::Stepper;

/// Trains one round.
///
/// The result is bit-identical for the same seed and device, with or without interruption.
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
