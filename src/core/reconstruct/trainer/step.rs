//! One step: the scene, its shake and its noise forward, the loss, and the backward pass.

use fled_gpu::{Buffer, GpuError, Recorder};
use rand::RngExt;

use super::Trainer;
use super::flight::Flight;
use crate::noise::IntersectionLimit;
use crate::reconstruct::optimizer::{SlotGradients, StepUniform};
use crate::reconstruct::schedule::Stream;
use crate::reconstruct::{Background, Densify};

impl Trainer<'_> {
    /// Submits one step to the device.
    pub(super) fn submit(&mut self, step: u32) -> Result<(), GpuError> {
        let index = self.schedule.view(step, self.model.views.len());
        self.write_numbers(step, index)?;
        self.last_view = index;
        if self.noise.is_some() {
            // The parameters of the noise field change while it is recorded.
            return self.record(index)?.submit().map(|_| ());
        }
        let pass = &self.model.pass;
        let kept = self.model.views[index].recording.take();
        let recording = match kept.filter(|kept| pass.serves(kept)) {
            Some(recording) => recording,
            None => {
                let recorder = self.record(index)?;
                self.model.pass.keep(recorder)
            }
        };
        recording.submit()?;
        self.model.views[index].recording = Some(recording);
        Ok(())
    }

    /// Writes the parameters that differ between two steps of one view.
    fn write_numbers(&self, step: u32, view: usize) -> Result<(), GpuError> {
        let (schedule, pass) = (&self.schedule, &self.model.pass);
        let camera = pass
            .seen_from(self.model.views[view].camera(), schedule.degree(step))
            .before(self.background(step));
        let mcmc = self.config.densify == Densify::Mcmc;
        let (count, extent) = (pass.gaussians.count, self.config.extent);
        let mut numbers = StepUniform::new(schedule, step, count, extent, mcmc);
        let (_, total_at) = pass.buffers().totals();
        numbers.capacity = pass.buffers().sizes().intersections as u32;
        numbers.total_at = total_at;
        pass.projection.camera.write(&[camera])?;
        self.optimizer.step.write(&[numbers])
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

    fn record(&mut self, index: usize) -> Result<Recorder, GpuError> {
        let target = self.model.views[index].target(self.gpu)?;
        let kept = self.model.views[index].kept(self.gpu)?;
        let (pass, view) = (&self.model.pass, &self.model.views[index]);
        let (buffers, loss) = (pass.buffers(), self.level.loss(view));
        let compare = |recorder: &mut Recorder, prediction: &Buffer<f32>| match &kept {
            None => loss.record(recorder, prediction, &target, &self.gradient),
            Some(kept) => loss.record_masked(recorder, prediction, [&target, kept], &self.gradient),
        };
        let shaken = self.model.shake.as_ref().zip(view.kernel.as_ref());
        let mut recorder = pass.recorder()?;
        let mut clean = &buffers.image;
        if let Some((shake, kernel)) = shaken {
            shake.record_forward(&mut recorder, kernel, &buffers.image)?;
            clean = shake.blurred();
        }
        match &mut self.noise {
            Some(noise) => {
                noise.begin_step(view.camera())?;
                noise.record_forward(&mut recorder, clean, &self.prediction)?;
                compare(&mut recorder, &self.prediction)?;
                let (counters, total_at) = buffers.totals();
                let limit = IntersectionLimit {
                    counters,
                    total_at,
                    capacity: buffers.sizes().intersections as u32,
                };
                noise.record_backward(&mut recorder, &self.gradient, &limit)?;
            }
            None => compare(&mut recorder, clean)?,
        }
        let mut by_render = &self.gradient;
        if let Some((shake, kernel)) = shaken {
            shake.record_backward(&mut recorder, kernel, &buffers.image, &self.gradient)?;
            by_render = shake.render_gradient();
        }
        self.backward.record(&mut recorder, &pass.projection, buffers, by_render)?;
        let slots = SlotGradients {
            slot_offsets: &buffers.slot_offsets,
            rows: &buffers.slots,
            totals: buffers.totals().0,
        };
        self.optimizer.record(&mut recorder, &pass.gaussians, &pass.projection, &slots)?;
        Ok(recorder)
    }

    /// Waits until at most `left` steps are in flight. A step whose intersections did not fit
    /// changed nothing, and is repeated in larger buffers.
    pub(super) fn settle(&mut self, flight: &mut Flight, left: usize) -> Result<(), GpuError> {
        while let Some((step, counts)) = flight.land(left)? {
            if counts.overflowed() {
                flight.redo.push_back(step);
                if let Some(noise) = &mut self.noise {
                    noise.take_back_step();
                }
                self.model.pass.make_room(&counts)?;
            }
        }
        Ok(())
    }
}
