//! Training the splats of one round: from posed views to a scene.
//!
//! The trainer decides what happens at which step; a device (`training.rs`) takes the steps.

pub mod checkpoint;
mod config;
pub mod densify;
mod error;
mod forward_model;
pub mod initialise;
mod look;
pub mod loss;
mod memory;
mod observed;
pub mod optimizer;
mod registration;
mod round;
pub mod schedule;
mod trainer;
mod training;
mod trial;
mod within_memory;

use crate::device::Device;
pub use crate::shake::Response;
pub use checkpoint::{Checkpoint, CheckpointError};
pub use config::{Background, Densify, Pace, TrainConfig};
pub use error::ReconstructError;
pub use initialise::{Point, camera_extent, initialise, scene_depth, scene_extent};
pub use look::Look;
pub use memory::device_bytes;
pub use registration::{CORRECTIONS, Registration};
pub use round::{
    CheckpointHook, LookHook, ProgressHook, Seen, SeenHook, TrainHooks, TrainStart, Trained,
    TrainingView,
};
pub use schedule::Schedule;
pub use trainer::Stepper;
pub use training::TrainingState;
pub use trial::{TrialError, trial};
pub use within_memory::within_memory;

/// Trains one round.
///
/// The result is bit-identical for the same seed and device, with or without interruption.
///
/// # Errors
/// [`ReconstructError`].
pub fn train(
    device: &Device,
    views: &[TrainingView],
    start: TrainStart,
    config: &TrainConfig,
    hooks: &mut TrainHooks<'_>,
) -> Result<Trained, ReconstructError> {
    trainer::Trainer::new(device, views, start, config)?.run(hooks)
}

#[cfg(test)]
mod tests;
