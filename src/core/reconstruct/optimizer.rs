//! The gradients of the Gaussians and their Adam update, in one kernel.

use bytemuck::{Pod, Zeroable};
use fled_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder, read, read_write, uniform};

use super::densify::Plan;
use super::schedule::Schedule;
use crate::splat::project::{DeviceGaussians, GEOMETRY_ROW, Projection};

/// From slot gradients to updated parameters.
pub const PROJECT_BACKWARD_ADAM: Kernel = Kernel::new(
    "train/project_backward_adam",
    &[
        uniform("camera"),
        uniform("train"),
        read("tile_counts"),
        read("slot_offsets"),
        read("slot_gradients"),
        read("intersections"),
        read_write("geometry"),
        read_write("geometry_moments"),
        read_write("sh"),
        read_write("sh_moments"),
        read_write("counters"),
    ],
);

/// Moves Gaussians.
const RELOCATE: Kernel = Kernel::new(
    "train/relocate",
    &[
        uniform("relocation"),
        read("moves"),
        read("shape"),
        read_write("geometry"),
        read_write("geometry_moments"),
        read_write("sh"),
        read_write("sh_moments"),
    ],
);

const BETA_M: f64 = 0.9;
const BETA_V: f64 = 0.999;
/// Rates of splat.md, "Defaults", for a round of 30,000 steps.
const RATE_LOG_SCALE: f64 = 5e-3;
const RATE_QUAT: f64 = 1e-3;
const RATE_OPACITY: f64 = 0.05;
const RATE_SH0: f64 = 2.5e-3;
const RATE_SH: f64 = 1.25e-4;
/// Weight of the means of the opacities and of the scales in the loss (MCMC).
const REGULARISER: f64 = 0.01;
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
    /// Of the second moments.
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
    /// Slots; the step is void above it.
    pub capacity: u32,
    /// Index of the number of intersections in its buffer.
    pub total_at: u32,
    /// Unused.
    pub pad: u32,
}

impl StepUniform {
    /// The numbers of `step` of a round with `count` Gaussians in a scene of `extent` world units. `densify`: whether MCMC
    /// runs; without it there is neither regulariser nor noise.
    pub fn new(schedule: &Schedule, step: u32, count: usize, extent: f64, densify: bool) -> Self {
        let (relative, haste) = (schedule.means_rate(step), schedule.haste());
        let t = step as i32 + 1;
        let weight = if densify { REGULARISER / count.max(1) as f64 } else { 0.0 };
        // Scales have a length: in units of the extent the same scene gets the same step at any scale.
        let explores = densify && schedule.explores(step);
        let noise = if explores { NOISE * relative / extent } else { 0.0 };
        Self {
            rates: [relative * extent, haste * RATE_LOG_SCALE, haste * RATE_QUAT, RATE_OPACITY]
                .map(|v| v as f32),
            rate_sh0: (haste * RATE_SH0) as f32,
            rate_sh: (haste * RATE_SH) as f32,
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

/// What the optimiser reads of the rasteriser's backward.
#[derive(Clone, Copy)]
pub struct SlotGradients<'a> {
    /// First slot of every visible Gaussian, [capacity].
    pub slot_offsets: &'a Buffer<u32>,
    /// [slots, 9]: mean xy, conic abc, rgb, opacity.
    pub rows: &'a Buffer<f32>,
    /// Holds the exact number of intersections at `StepUniform::total_at`.
    pub totals: &'a Buffer<u32>,
}

/// Adam's state on the device.
pub struct Optimizer {
    /// The numbers of the step; written before each use.
    pub step: Buffer<StepUniform>,
    /// [capacity, 2, 12].
    pub geometry_moments: Buffer<f32>,
    /// [capacity, 2, coefficients, 3].
    pub sh_moments: Buffer<f32>,
    /// [0]: non-finite gradients dropped.
    pub counters: Buffer<u32>,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct RelocateUniform {
    rows: u32,
    sh_row: u32,
    pad: [u32; 2],
}

impl Optimizer {
    /// Moments of zero for `gaussians`.
    ///
    /// # Errors
    /// Out of memory, or above what the adapter binds.
    pub fn new(gpu: &Gpu, gaussians: &DeviceGaussians) -> Result<Self, GpuError> {
        Ok(Self {
            step: gpu.create("step", 1)?,
            geometry_moments: gpu.create("geometry moments", 2 * GEOMETRY_ROW * gaussians.capacity)?,
            sh_moments: gpu.create("sh moments", 2 * gaussians.sh.len())?,
            counters: gpu.create("optimizer counters", 4)?,
        })
    }

    /// Adds the backward projection and the update of every Gaussian.
    ///
    /// # Errors
    /// A shader or binding error.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        gaussians: &DeviceGaussians,
        projection: &Projection,
        slots: &SlotGradients<'_>,
    ) -> Result<(), GpuError> {
        self.record_as(&PROJECT_BACKWARD_ADAM, recorder, gaussians, projection, slots)
    }

    fn record_as(
        &self,
        kernel: &Kernel,
        recorder: &mut Recorder,
        gaussians: &DeviceGaussians,
        projection: &Projection,
        slots: &SlotGradients<'_>,
    ) -> Result<(), GpuError> {
        recorder.dispatch_items(
            kernel,
            &[
                &projection.camera,
                &self.step,
                &projection.tile_counts,
                slots.slot_offsets,
                slots.rows,
                slots.totals,
                &gaussians.geometry,
                &self.geometry_moments,
                &gaussians.sh,
                &self.sh_moments,
                &self.counters,
            ],
            gaussians.capacity,
        )
    }

    /// Carries out a densification: copies, shapes, cleared moments.
    ///
    /// # Errors
    /// A device error.
    pub fn relocate(&self, gpu: &Gpu, gaussians: &DeviceGaussians, plan: &Plan) -> Result<(), GpuError> {
        if plan.moves.is_empty() {
            return Ok(());
        }
        let mut recorder = gpu.recorder();
        let coefficients = (gaussians.sh_degree + 1) * (gaussians.sh_degree + 1);
        let uniform =
            RelocateUniform { rows: plan.moves.len() as u32, sh_row: 3 * coefficients, pad: [0; 2] };
        recorder.dispatch_items(
            &RELOCATE,
            &[
                &gpu.upload("relocation", &[uniform])?,
                &gpu.upload("moves", &plan.moves)?,
                &gpu.upload("shapes", &plan.shapes)?,
                &gaussians.geometry,
                &self.geometry_moments,
                &gaussians.sh,
                &self.sh_moments,
            ],
            plan.moves.len(),
        )?;
        recorder.submit().map(|_| ())
    }
}

#[cfg(test)]
mod tests;
