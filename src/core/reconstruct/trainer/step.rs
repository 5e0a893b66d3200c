//! One step, as the device takes it.

use fled_gpu::GpuError;
use rand::RngExt;

use super::Trainer;
use crate::reconstruct::optimizer::StepUniform;
use crate::reconstruct::schedule::Stream;
use crate::reconstruct::training::Step;
use crate::reconstruct::{Background, Densify};

impl Trainer<'_> {
    /// Submits one step to the device.
    pub(super) fn submit(&mut self, step: u32) -> Result<(), GpuError> {
        let (schedule, count) = (&self.schedule, self.scene.count());
        let index = schedule.view(step, self.model.views.len());
        let view = &self.model.views[index];
        if !self.scene.has_target(index) {
            self.scene.set_target(index, &view.target())?;
        }
        let mcmc = self.config.densify == Densify::Mcmc;
        self.scene.submit(&Step {
            view: index,
            camera: view.camera(),
            degree: schedule.degree(step),
            background: self.background(step),
            kernel: self.config.shake.as_ref().map(|_| &view.kernel),
            update: StepUniform::new(schedule, step, count, self.config.extent, mcmc),
        })
    }

    fn background(&self, step: u32) -> [f32; 3] {
        match self.config.background {
            Background::Black => [0.0; 3],
            Background::Random => {
                let mut random = self.schedule.generator(Stream::Background, u64::from(step));
                random.random()
            }
        }
    }

    /// Waits until at most `left` steps are in flight. A step whose intersections did not fit
    /// changed nothing, and is repeated in larger buffers.
    pub(super) fn settle(&mut self, left: usize) -> Result<(), GpuError> {
        self.again.extend(self.scene.settle(left)?);
        Ok(())
    }
}
