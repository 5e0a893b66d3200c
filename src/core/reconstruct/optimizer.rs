//! The gradients of the Gaussians and their Adam update, in one kernel.

use bytemuck::{Pod, Zeroable};
use fled_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder, Rows, read, read_write, uniform};

use super::densify::Plan;
use super::schedule::Schedule;
use crate::splat::project::Projection;
use crate::splat::rasterize::SlotRows;
use crate::splat::rows::{DeviceGaussians, GEOMETRY_ROW};

/// From slot gradients to updated parameters.
pub const PROJECT_BACKWARD_ADAM: Kernel = Kernel::new(
    "train/project_backward_adam",
    &[
        uniform("camera"),
        uniform("train"),
        uniform("part"),
        read_write("spans"),
        read("slot_colours"),
        read("slot_moments"),
        read("slot_words"),
        read_write("geometry"),
        read_write("geometry_moments"),
        read_write("sh"),
        read_write("sh_moments"),
    ],
);

/// Copies the sources of a relocation.
const RELOCATE_TAKE: Kernel = Kernel::new(
    "train/relocate_take",
    &[
        uniform("relocation"),
        uniform("part"),
        read("moves"),
        read("geometry"),
        read("sh"),
        read_write("taken"),
    ],
);

/// Writes the copies to their targets.
const RELOCATE_PUT: Kernel = Kernel::new(
    "train/relocate_put",
    &[
        uniform("relocation"),
        uniform("part"),
        read("moves"),
        read("shape"),
        read("taken"),
        read_write("geometry"),
        read_write("geometry_moments"),
        read_write("sh"),
        read_write("sh_moments"),
    ],
);

const BETA_M: f64 = 0.9;
const BETA_V: f64 = 0.999;
/// Rates of the published trainers, for a round of 30,000 steps.
const RATE_LOG_SCALE: f64 = 5e-3;
const RATE_QUAT: f64 = 1e-3;
const RATE_OPACITY: f64 = 0.05;
const RATE_SH0: f64 = 2.5e-3;
const RATE_SH: f64 = 1.25e-4;
/// Weight of the means of the opacities and of the scales in the loss (MCMC). The authors' 0.01 was
/// chosen for rounds of 30,000 steps and millions of Gaussians.
const REGULARISER: f64 = 0.002;
/// Exploration noise, in units of the rate of the means (MCMC).
const NOISE: f64 = 5e5;

/// `StepUniform` of shaders/shared/train.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct StepUniform {
    /// Means, log-scales, quaternions, opacity logits.
    pub rates: [f32; 4],
    /// Constant harmonic.
    pub rate_sh0: f32,
    /// Higher harmonics.
    pub rate_sh: f32,
    /// 1 / (1 - beta^t) of the first moments.
    pub bias_m: f32,
    /// 1 / (1 - beta^t) of the second moments.
    pub bias_v: f32,
    /// Gradient of the opacity regulariser by an opacity.
    pub opacity_weight: f32,
    /// Gradient of the scale regulariser by a scale.
    pub scale_weight: f32,
    /// Scale of the exploration noise.
    pub noise: f32,
    /// Low bits of the seed.
    pub seed: u32,
    /// 0-based.
    pub step: u32,
    /// Number of slots; a step with more intersections is void.
    pub capacity: u32,
    /// Fills the uniform's last vector.
    pub pad: [u32; 2],
}

impl StepUniform {
    /// The parameters of `step` in a round with `count` Gaussians and a scene of `extent` world
    /// units. `mcmc`: whether MCMC densifies; without it there is neither regulariser nor noise.
    pub fn new(schedule: &Schedule, step: u32, count: usize, extent: f64, mcmc: bool) -> Self {
        let (relative, speedup) = (schedule.means_rate(step), schedule.speedup());
        let t = step as i32 + 1;
        let weight = if mcmc { REGULARISER / count.max(1) as f64 } else { 0.0 };
        // Scales have a length: in units of the extent, a scene takes the same step at any scale.
        let explores = mcmc && schedule.explores(step);
        let noise = if explores { NOISE * relative / extent } else { 0.0 };
        Self {
            rates: [relative * extent, speedup * RATE_LOG_SCALE, speedup * RATE_QUAT, RATE_OPACITY]
                .map(|v| v as f32),
            rate_sh0: (speedup * RATE_SH0) as f32,
            rate_sh: (speedup * RATE_SH) as f32,
            bias_m: (1.0 / (1.0 - BETA_M.powi(t))) as f32,
            bias_v: (1.0 / (1.0 - BETA_V.powi(t))) as f32,
            opacity_weight: weight as f32,
            scale_weight: (weight / 3.0 / extent) as f32,
            noise: noise as f32,
            seed: schedule.seed as u32 ^ (schedule.seed >> 32) as u32,
            step,
            ..Self::default()
        }
    }
}

/// Trained numbers of a [`GeometryRow`](crate::splat::rows::GeometryRow).
const TRAINED: usize = GEOMETRY_ROW - 1;

/// Adam's moments of the geometry of one Gaussian. The last number of each row, else padding, holds
/// the statistics of classic densification, or zero without it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GeometryMoments {
    /// First moments.
    pub first: [f32; TRAINED],
    /// Sum of the lengths of the gradients by position, in normalised device coordinates.
    pub gradient_lengths: f32,
    /// Second moments.
    pub second: [f32; TRAINED],
    /// Number of views in that sum.
    pub gradient_views: f32,
}

/// Adam's state on the device.
pub struct Optimizer {
    /// [`PROJECT_BACKWARD_ADAM`], with or without accumulation of the positions' gradients.
    update: Kernel,
    /// The parameters of the step; written before each use.
    pub step: Buffer<StepUniform>,
    /// [capacity, 2, 12].
    pub geometry_moments: Rows<f32>,
    /// [capacity, 2, `sh_row`].
    pub sh_moments: Rows<f32>,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct RelocateUniform {
    rows: u32,
    sh_row: u32,
    pad: [u32; 2],
}

impl Optimizer {
    /// Zero moments for `gaussians`. `accumulates`: whether the gradients by position are summed
    /// up.
    ///
    /// # Errors
    /// Out of memory, or more than the adapter can bind.
    pub fn new(
        gpu: &Gpu,
        gaussians: &DeviceGaussians,
        accumulates: bool,
    ) -> Result<Self, GpuError> {
        let (rows, per_part) = (gaussians.capacity, gaussians.sh.per_part());
        let accumulating = PROJECT_BACKWARD_ADAM.with(&[("ACCUMULATE_POSITION", 1)]);
        Ok(Self {
            update: if accumulates { accumulating } else { PROJECT_BACKWARD_ADAM },
            step: gpu.create("step", 1)?,
            geometry_moments: gpu.create_rows(
                "geometry moments",
                rows,
                2 * GEOMETRY_ROW,
                per_part,
            )?,
            sh_moments: gpu.create_rows("sh moments", rows, 2 * gaussians.sh.length(), per_part)?,
        })
    }

    /// Records the backward projection and the update of every Gaussian.
    ///
    /// # Errors
    /// A shader or binding error.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        gaussians: &DeviceGaussians,
        projection: &Projection,
        slots: &SlotRows,
    ) -> Result<(), GpuError> {
        self.record_as(&self.update, recorder, gaussians, projection, slots)
    }

    fn record_as(
        &self,
        kernel: &Kernel,
        recorder: &mut Recorder,
        gaussians: &DeviceGaussians,
        projection: &Projection,
        slots: &SlotRows,
    ) -> Result<(), GpuError> {
        for (n, part) in gaussians.parts.iter().enumerate() {
            recorder.dispatch_items(
                kernel,
                &[
                    &projection.camera,
                    &self.step,
                    &part.uniform,
                    &projection.spans,
                    &slots.colours,
                    &slots.moments,
                    &slots.words,
                    &gaussians.geometry.parts()[n],
                    &self.geometry_moments.parts()[n],
                    &gaussians.sh.parts()[n],
                    &self.sh_moments.parts()[n],
                ],
                part.rows,
            )?;
        }
        Ok(())
    }

    /// The moments of the geometry of `count` Gaussians.
    ///
    /// # Errors
    /// A device error.
    pub fn read_geometry_moments(&self, count: usize) -> Result<Vec<GeometryMoments>, GpuError> {
        let numbers = self.geometry_moments.read(count)?;
        Ok(bytemuck::pod_collect_to_vec(&numbers))
    }

    /// Runs a densification: copies, shapes, cleared moments.
    ///
    /// # Errors
    /// A device error.
    pub fn relocate(
        &self,
        gpu: &Gpu,
        gaussians: &DeviceGaussians,
        plan: &Plan,
    ) -> Result<(), GpuError> {
        let sh_row = gaussians.sh.length();
        let taken_row = GEOMETRY_ROW + sh_row;
        let most = gpu.rows_per_part(taken_row * size_of::<f32>());
        // The copied values never change: a source keeps its place, rotation and colour.
        for (moves, shapes) in plan.moves.chunks(most).zip(plan.shapes.chunks(most)) {
            let uniform =
                RelocateUniform { rows: moves.len() as u32, sh_row: sh_row as u32, pad: [0; 2] };
            let uniform = gpu.upload("relocation", &[uniform])?;
            let (moves, shapes) = (gpu.upload("moves", moves)?, gpu.upload("shapes", shapes)?);
            let taken = gpu.create::<f32>("taken", moves.len() * taken_row)?;
            let mut recorder = gpu.recorder();
            for (n, part) in gaussians.parts.iter().enumerate() {
                let (geometry, sh) = (&gaussians.geometry.parts()[n], &gaussians.sh.parts()[n]);
                recorder.dispatch_items(
                    &RELOCATE_TAKE,
                    &[&uniform, &part.uniform, &moves, geometry, sh, &taken],
                    moves.len(),
                )?;
            }
            for (n, part) in gaussians.parts.iter().enumerate() {
                recorder.dispatch_items(
                    &RELOCATE_PUT,
                    &[
                        &uniform,
                        &part.uniform,
                        &moves,
                        &shapes,
                        &taken,
                        &gaussians.geometry.parts()[n],
                        &self.geometry_moments.parts()[n],
                        &gaussians.sh.parts()[n],
                        &self.sh_moments.parts()[n],
                    ],
                    moves.len(),
                )?;
            }
            recorder.submit()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
