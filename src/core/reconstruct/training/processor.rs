//! Training on the processor. A step is done when it is submitted.

use fled_cpu::blend::SlotSums;
use fled_cpu::loss::{self, Loss, LossMeans, Noise, Shares};
use fled_cpu::noise::NoiseField;
use fled_cpu::population::Population;
use fled_cpu::shake::{Kernel, Response as Table};
use fled_cpu::update::{Blended, Step as Update};
use fled_gpu::GpuError;

use super::{Setup, Step, Training, TrainingState};
use crate::camera::Camera;
use crate::device::{ProcessorScene, Scene, Shaken};
use crate::image::Image;
use crate::noise::{self, Inspection, StateError};
use crate::reconstruct::densify::Plan;
use crate::reconstruct::loss::{L1_SHARE, SSIM_SHARE, quantised};
use crate::reconstruct::observed::Target;
use crate::reconstruct::optimizer::StepUniform;
use crate::shake::{Response, SMOOTH_BEND, SMOOTH_WEIGHT, ShakeKernel};
use crate::splat::processor;
use crate::splat::rasterize::SplatCounts;
use crate::splat::rows::GeometryRow;

const SHARES: Shares = Shares { absolute: L1_SHARE, similarity: SSIM_SHARE };

/// A view of the training.
#[derive(Default)]
struct ProcessorView {
    size: [usize; 2],
    /// Planar RGB in units of 1/65535; empty before the first step.
    target: Vec<u16>,
    /// The pixels that count; all if `None`.
    kept: Option<Vec<bool>>,
    noise: Noise,
    /// The kernel of its last step, in both forms.
    kernel: Option<(ShakeKernel, Kernel)>,
}

/// A scene in training on the processor.
pub(super) struct ProcessorTraining {
    scene: ProcessorScene,
    views: Vec<ProcessorView>,
    response: Option<Table>,
    sums: SlotSums,
    loss: Loss,
    means: LossMeans,
    /// The derivative of the loss by the prediction, planar [3, height, width].
    gradient: Vec<f32>,
    noise: Option<NoiseField>,
    /// The render with its noise; what the loss compares if there is a noise field.
    prediction: Vec<f32>,
    accumulates: bool,
    non_finite: u32,
}

impl ProcessorTraining {
    pub(super) fn new(setup: &Setup<'_>) -> Self {
        let population = processor::population(setup.gaussians).in_training();
        Self {
            scene: ProcessorScene::of(population),
            views: (0..setup.views).map(|_| ProcessorView::default()).collect(),
            response: setup.shake.map(Response::on_processor),
            sums: SlotSums::default(),
            loss: Loss::default(),
            means: LossMeans::default(),
            gradient: Vec::new(),
            noise: setup.noise.map(noise::processor::field),
            prediction: Vec::new(),
            accumulates: setup.accumulates,
            non_finite: 0,
        }
    }
}

impl ProcessorView {
    fn set_kernel(&mut self, wanted: Option<&ShakeKernel>) {
        if self.kernel.as_ref().map(|(kernel, _)| kernel) != wanted {
            self.kernel = wanted.map(|kernel| (kernel.clone(), kernel.on_processor(self.size)));
        }
    }

    fn compare(&self, by: &mut Loss, prediction: &[f32], gradient: &mut [f32]) -> LossMeans {
        let target = loss::Target { values: &self.target, size: self.size, noise: &self.noise };
        match &self.kept {
            None => by.run(prediction, target, SHARES, gradient),
            Some(kept) => by.run_masked(prediction, target, kept, SHARES, gradient),
        }
    }
}

fn update(step: &StepUniform, accumulates: bool) -> Update {
    Update {
        rates: step.rates,
        rate_sh0: step.rate_sh0,
        rate_sh: step.rate_sh,
        bias: [step.bias_m, step.bias_v],
        opacity_weight: step.opacity_weight,
        scale_weight: step.scale_weight,
        noise: step.noise,
        seed: step.seed,
        step: step.step,
        accumulates,
    }
}

impl Scene for ProcessorTraining {
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

impl Training for ProcessorTraining {
    fn count(&self) -> usize {
        self.scene.population.len()
    }

    fn look(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError> {
        // Each step draws its own view first.
        self.scene.render(camera, degree)
    }

    fn set_sizes(&mut self, sizes: &[[usize; 2]]) -> Result<(), GpuError> {
        for (view, &size) in self.views.iter_mut().zip(sizes) {
            *view = ProcessorView { size, ..ProcessorView::default() };
        }
        Ok(())
    }

    fn has_target(&self, view: usize) -> bool {
        !self.views[view].target.is_empty()
    }

    fn set_target(&mut self, view: usize, target: &Target) -> Result<(), GpuError> {
        let view = &mut self.views[view];
        view.target = target.image.data().iter().map(|&value| quantised(value)).collect();
        view.kept = target.mask.as_ref().map(|mask| mask.pixels().to_vec());
        view.noise = target.noise;
        Ok(())
    }

    fn submit(&mut self, step: &Step<'_>) -> Result<(), GpuError> {
        let view = self.scene.draw(step.camera, step.degree, step.background);
        let photograph = &mut self.views[step.view];
        photograph.set_kernel(step.kernel);
        let ProcessorScene { population, projection, bins, canvas, shake } = &mut self.scene;
        let shaken = self.response.as_ref().zip(photograph.kernel.as_ref());
        let mut prediction = &canvas.image;
        if let Some((response, (_, kernel))) = shaken {
            shake.forward(&canvas.image, kernel, response);
            prediction = &shake.blurred;
        }
        if let Some(noise) = &self.noise {
            noise.forward(&view, prediction, &mut self.prediction);
            prediction = &self.prediction;
        }
        self.gradient.resize(prediction.len(), 0.0);
        self.means = photograph.compare(&mut self.loss, prediction, &mut self.gradient);
        if let Some(noise) = &mut self.noise {
            noise.backward(&view, &self.gradient);
        }
        let mut by_render = &self.gradient;
        if let Some((response, (_, kernel))) = shaken {
            let weight = (SMOOTH_WEIGHT / canvas.image.len() as f64) as f32;
            let smooth = [weight, SMOOTH_BEND as f32];
            shake.backward(&canvas.image, &self.gradient, kernel, response, smooth);
            by_render = &shake.render_gradient;
        }
        self.sums.run(projection, bins, canvas, by_render, &view);
        let blended = Blended { view: &view, bins, sums: &self.sums };
        let dropped = blended.update(population, &update(&step.update, self.accumulates));
        self.non_finite = self.non_finite.saturating_add(dropped as u32);
        Ok(())
    }

    fn settle(&mut self, _left: usize) -> Result<Vec<u32>, GpuError> {
        Ok(Vec::new())
    }

    fn is_done(&mut self) -> Result<bool, GpuError> {
        Ok(true)
    }

    fn loss(&self) -> Result<f64, GpuError> {
        Ok(L1_SHARE * self.means.absolute + SSIM_SHARE * (1.0 - self.means.similarity))
    }

    fn non_finite(&self) -> Result<u32, GpuError> {
        Ok(self.non_finite)
    }

    fn geometry(&self) -> Result<Vec<GeometryRow>, GpuError> {
        Ok(processor::geometry(&self.scene.population))
    }

    fn relocate(&mut self, plan: &Plan) -> Result<(), GpuError> {
        self.scene.population.relocate(&plan.moves, &plan.shapes, plan.count);
        Ok(())
    }

    fn inspect_noise(&self) -> Result<Option<Inspection>, GpuError> {
        let clean = match &self.response {
            Some(_) => &self.scene.shake.blurred,
            None => &self.scene.canvas.image,
        };
        Ok(self.noise.as_ref().map(|_| noise::processor::compare(clean, &self.prediction)))
    }

    fn save(&self) -> Result<TrainingState, GpuError> {
        let population = &self.scene.population;
        let [geometry_moments, sh_moments] = processor::moments(population);
        Ok(TrainingState {
            sh_degree: population.sh_degree(),
            intersections: 0,
            non_finite: self.non_finite,
            geometry: bytemuck::pod_collect_to_vec(&processor::geometry(population)),
            geometry_moments,
            sh: processor::harmonics(population),
            sh_moments,
            noise: self.noise.as_ref().map_or(Vec::new(), noise::processor::save),
        })
    }

    fn restore(&mut self, state: &TrainingState) -> Result<(), StateError> {
        if self.noise.is_some() {
            self.noise = Some(noise::processor::restore(&state.noise)?);
        }
        let mut population: Population = processor::population(&state.gaussians()).in_training();
        let moments = [&state.geometry_moments[..], &state.sh_moments];
        processor::set_moments(&mut population, moments);
        self.scene.population = population;
        self.non_finite = state.non_finite;
        Ok(())
    }

    #[cfg(test)]
    fn in_flight(&self) -> usize {
        0
    }
}
