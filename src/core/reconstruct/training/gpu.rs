//! Training on a GPU. A step is one submission: project, sort, blend, noise, loss, and the way back
//! to Adam. The host waits only for the number of intersections of the step before last.

use std::collections::BTreeMap;

use fled_gpu::{Buffer, Gpu, GpuError, Recorder};

use super::flight::Flight;
use super::{Setup, Step, Training, TrainingState};
use crate::camera::Camera;
use crate::device::{GpuScene, Scene, Shaken};
use crate::image::Image;
use crate::noise::{Inspection, IntersectionLimit, NoiseField, StateError};
use crate::reconstruct::densify::Plan;
use crate::reconstruct::loss::{GpuTarget, Loss, upload_mask};
use crate::reconstruct::observed::Target;
use crate::reconstruct::optimizer::Optimizer;
use crate::shake::{DeviceKernel, Shake};
use crate::splat::pass::PassRecording;
use crate::splat::rasterize::{Backward, Specialisation, SplatCounts};
use crate::splat::rows::{DeviceGaussians, GeometryRow};

/// A view on the device.
#[derive(Default)]
struct GpuView {
    size: [usize; 2],
    target: Option<GpuTarget>,
    /// The packed mask.
    kept: Option<Buffer<u32>>,
    /// `None` before its first step, and without shake.
    kernel: Option<DeviceKernel>,
    /// The recording of a step without the noise field.
    recording: Option<PassRecording>,
}

/// A scene in training on a GPU.
pub(super) struct GpuTraining {
    gpu: Gpu,
    scene: GpuScene,
    /// Draws into buffers of its own: growing those in training for a look would change which steps
    /// are repeated, and so the scene.
    onlooker: Option<GpuScene>,
    views: Vec<GpuView>,
    last_view: usize,
    /// A loss for each size of a view.
    losses: BTreeMap<[usize; 2], Loss>,
    backward: Backward,
    optimizer: Optimizer,
    shake: Option<Shake>,
    noise: Option<NoiseField>,
    prediction: Buffer<f32>,
    gradient: Buffer<f32>,
    flight: Flight,
}

impl GpuTraining {
    pub(super) fn new(gpu: &Gpu, setup: &Setup<'_>) -> Result<Self, GpuError> {
        let values = 3 * setup.size[0] * setup.size[1];
        let gaussians = DeviceGaussians::upload(gpu, setup.gaussians, setup.capacity)?;
        let noise = setup.noise.map(|seed| NoiseField::new(gpu, seed, setup.size));
        let shake = setup.shake.map(|response| Shake::new(gpu, setup.size, response));
        Ok(Self {
            optimizer: Optimizer::new(gpu, &gaussians, setup.accumulates)?,
            scene: GpuScene::new(gpu, gaussians, setup.size, true)?,
            onlooker: None,
            views: (0..setup.views).map(|_| GpuView::default()).collect(),
            last_view: 0,
            losses: BTreeMap::new(),
            backward: Backward::new(Specialisation::for_adapter(gpu.describe())),
            shake: shake.transpose()?,
            noise: noise.transpose()?,
            prediction: gpu.create("prediction", values)?,
            gradient: gpu.create("image gradient", values)?,
            flight: Flight::default(),
            gpu: gpu.clone(),
        })
    }

    /// Writes the parameters that differ between two steps of one view.
    fn write_numbers(&mut self, step: &Step<'_>) -> Result<(), GpuError> {
        let pass = &self.scene.pass;
        let camera = pass.seen_from(step.camera, step.degree).before(step.background);
        let mut numbers = step.update;
        numbers.capacity = pass.buffers().sizes().intersections as u32;
        pass.projection.camera.write(&[camera])?;
        self.optimizer.step.write(&[numbers])?;
        let (Some(shake), Some(wanted)) = (&self.shake, step.kernel) else {
            return Ok(());
        };
        let view = &mut self.views[step.view];
        let mut kernel = match view.kernel.take() {
            Some(kernel) => kernel,
            None => DeviceKernel::new(&self.gpu)?,
        };
        if !kernel.is_set_to(wanted, view.size) {
            shake.set(&mut kernel, view.size, wanted.clone())?;
        }
        view.kernel = Some(kernel);
        Ok(())
    }

    fn record(&mut self, step: &Step<'_>) -> Result<Recorder, GpuError> {
        let (pass, view) = (&self.scene.pass, &self.views[step.view]);
        let (buffers, loss) = (pass.buffers(), &self.losses[&view.size]);
        let Some(target) = &view.target else {
            return Err(GpuError::Validation("a view without a target".to_owned()));
        };
        let compare = |recorder: &mut Recorder, prediction: &Buffer<f32>| match &view.kept {
            None => loss.record(recorder, prediction, target, &self.gradient),
            Some(kept) => loss.record_masked(recorder, prediction, (target, kept), &self.gradient),
        };
        let shaken = self.shake.as_ref().zip(view.kernel.as_ref());
        let mut recorder = pass.recorder()?;
        let mut clean = &buffers.image;
        if let Some((shake, kernel)) = shaken {
            shake.record_forward(&mut recorder, kernel, &buffers.image)?;
            clean = shake.blurred();
        }
        match &mut self.noise {
            Some(noise) => {
                noise.begin_step(step.camera)?;
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
        self.optimizer.record(&mut recorder, &pass.gaussians, &pass.projection, &buffers.slots)?;
        Ok(recorder)
    }
}

impl Scene for GpuTraining {
    fn render(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError> {
        self.scene.render(camera, degree)
    }

    fn render_shaken(
        &mut self,
        camera: &Camera,
        degree: u32,
        shaken: Shaken<'_>,
    ) -> Result<Image, GpuError> {
        self.scene.render_shaken(camera, degree, shaken)
    }

    fn counts(&self) -> Result<SplatCounts, GpuError> {
        self.scene.counts()
    }
}

impl Training for GpuTraining {
    fn count(&self) -> usize {
        self.scene.pass.gaussians.count
    }

    fn look(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError> {
        let gaussians = &self.scene.pass.gaussians;
        let mut onlooker = match self.onlooker.take() {
            Some(onlooker) => onlooker,
            // The clone shares the buffers in training.
            None => GpuScene::new(&self.gpu, gaussians.clone(), [1, 1], false)?,
        };
        onlooker.pass.gaussians.count = gaussians.count;
        self.onlooker.insert(onlooker).render(camera, degree)
    }

    fn set_sizes(&mut self, sizes: &[[usize; 2]]) -> Result<(), GpuError> {
        self.losses.clear();
        for (view, &size) in self.views.iter_mut().zip(sizes) {
            *view = GpuView { size, kernel: view.kernel.take(), ..GpuView::default() };
            if !self.losses.contains_key(&size) {
                self.losses.insert(size, Loss::new(&self.gpu, size[0], size[1])?);
            }
        }
        Ok(())
    }

    fn has_target(&self, view: usize) -> bool {
        self.views[view].target.is_some()
    }

    fn set_target(&mut self, view: usize, target: &Target) -> Result<(), GpuError> {
        let view = &mut self.views[view];
        if let (Some(mask), Some(loss)) = (&target.mask, self.losses.get_mut(&view.size)) {
            loss.make_masks(&self.gpu)?;
            view.kept = Some(upload_mask(&self.gpu, mask)?);
        }
        view.target = Some(GpuTarget::upload(&self.gpu, &target.image, &target.noise)?);
        Ok(())
    }

    fn submit(&mut self, step: &Step<'_>) -> Result<(), GpuError> {
        self.write_numbers(step)?;
        self.last_view = step.view;
        if self.noise.is_some() {
            // The parameters of the noise field change while it is recorded.
            self.record(step)?.submit()?;
        } else {
            let kept = self.views[step.view].recording.take();
            let recording = match kept.filter(|kept| self.scene.pass.serves(kept)) {
                Some(recording) => recording,
                None => {
                    let recorder = self.record(step)?;
                    self.scene.pass.keep(recorder)
                }
            };
            self.views[step.view].recording.insert(recording).submit()?;
        }
        self.flight.begin(step.update.step, self.scene.pass.buffers().counts()?);
        Ok(())
    }

    fn settle(&mut self, left: usize) -> Result<Vec<u32>, GpuError> {
        let mut again = Vec::new();
        while let Some((step, counts)) = self.flight.land(left)? {
            if counts.overflowed() {
                again.push(step);
                if let Some(noise) = &mut self.noise {
                    noise.take_back_step();
                }
                self.scene.pass.make_room(&counts)?;
            }
        }
        Ok(again)
    }

    fn is_done(&mut self) -> Result<bool, GpuError> {
        self.flight.is_done()
    }

    fn loss(&self) -> Result<f64, GpuError> {
        Ok(self.losses[&self.views[self.last_view].size].value()?.total)
    }

    fn non_finite(&self) -> Result<u32, GpuError> {
        self.scene.pass.projection.dropped()
    }

    fn geometry(&self) -> Result<Vec<GeometryRow>, GpuError> {
        self.scene.pass.gaussians.read_geometry()
    }

    fn relocate(&mut self, plan: &Plan) -> Result<(), GpuError> {
        let gaussians = &mut self.scene.pass.gaussians;
        self.optimizer.relocate(&self.gpu, gaussians, plan)?;
        gaussians.count = plan.count;
        Ok(())
    }

    fn inspect_noise(&self) -> Result<Option<Inspection>, GpuError> {
        let Some(noise) = &self.noise else {
            return Ok(None);
        };
        let render = &self.scene.pass.buffers().image;
        let clean = self.shake.as_ref().map_or(render, Shake::blurred);
        Ok(Some(noise.inspect(clean, &self.prediction)?))
    }

    fn save(&self) -> Result<TrainingState, GpuError> {
        let gaussians = &self.scene.pass.gaussians;
        let count = gaussians.count;
        Ok(TrainingState {
            sh_degree: gaussians.sh_degree,
            intersections: self.scene.pass.buffers().sizes().intersections as u32,
            non_finite: self.non_finite()?,
            geometry: gaussians.geometry.read(count)?,
            geometry_moments: self.optimizer.geometry_moments.read(count)?,
            sh: gaussians.sh.read(count)?,
            sh_moments: self.optimizer.sh_moments.read(count)?,
            noise: self.noise.as_ref().map_or(Ok(Vec::new()), NoiseField::save)?,
        })
    }

    fn restore(&mut self, state: &TrainingState) -> Result<(), StateError> {
        let gaussians = &mut self.scene.pass.gaussians;
        gaussians.geometry.write(&state.geometry)?;
        gaussians.sh.write(&state.sh)?;
        gaussians.count = state.count();
        self.optimizer.geometry_moments.write(&state.geometry_moments)?;
        self.optimizer.sh_moments.write(&state.sh_moments)?;
        self.scene.pass.projection.set_dropped(state.non_finite)?;
        if let Some(noise) = &mut self.noise {
            noise.restore(&state.noise)?;
        }
        Ok(self.scene.pass.set_room(state.intersections as usize)?)
    }

    #[cfg(test)]
    fn in_flight(&self) -> usize {
        self.flight.len()
    }
}
