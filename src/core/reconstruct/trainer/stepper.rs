//! A round in parts of a few steps, for benchmarks.

use fled_gpu::GpuError;

use super::Trainer;
use crate::cancel::CancelToken;
use crate::device::Device;
use crate::gaussians::Gaussians;
use crate::reconstruct::{ReconstructError, TrainConfig, TrainHooks, TrainStart, TrainingView};
use crate::splat::rasterize::SplatCounts;

/// The loop of [`train`](crate::reconstruct::train) itself, in parts, so that benchmarks measure
/// the real code. Makes no checkpoints.
pub struct Stepper<'a>(Trainer<'a>);

impl<'a> Stepper<'a> {
    /// Starts a round with `gaussians` at step `first`, as if the earlier steps had been trained:
    /// the work of a step depends on its place in the round. Adam's moments are zero.
    ///
    /// # Errors
    /// As [`train`](crate::reconstruct::train).
    pub fn new(
        device: &Device,
        views: &'a [TrainingView],
        gaussians: Gaussians,
        config: &'a TrainConfig,
        first: u32,
    ) -> Result<Self, ReconstructError> {
        let mut trainer = Trainer::new(device, views, TrainStart::Fresh(gaussians), config)?;
        trainer.next = first.min(config.steps);
        Ok(Self(trainer))
    }

    /// Trains `steps` steps, or fewer at the end of the round, and waits for the last of them.
    ///
    /// # Errors
    /// As [`train`](crate::reconstruct::train).
    pub fn advance(&mut self, steps: u32, cancel: &CancelToken) -> Result<(), ReconstructError> {
        let last = self.0.next.saturating_add(steps).min(self.0.config.steps);
        let mut hooks = TrainHooks {
            cancel,
            progress: &mut |_, _, _| {},
            checkpoint: None,
            seen: None,
            look: None,
        };
        self.0.train_to(last, &mut hooks)
    }

    #[cfg(test)]
    pub(in crate::reconstruct) fn gaussians(&self) -> Gaussians {
        self.0.scene.save().expect("read").gaussians()
    }

    /// The intersections of the last step; reads them back from the device.
    ///
    /// # Errors
    /// A device error.
    pub fn counts(&self) -> Result<SplatCounts, GpuError> {
        self.0.scene.counts()
    }
}
