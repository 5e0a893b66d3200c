//! The loss of a training step, `0.8 mean|p - t| + 0.2 (1 - mean SSIM(p, t))`, and its gradient.
//!
//! Differs from the paper where the noise of a target is known: SSIM's second constant grows by
//! twice the variance of the noise at the brightness of the window (docs/decisions/trainer.md).
//! Without it, SSIM compares contrasts of windows that are mostly noise.
//!
//! SSIM has an 11 x 11 Gaussian window of sigma 1.5 and is zero-padded, as in published trainers
//! (the metrics use the valid region only, so the two numbers differ). The gradient is written
//! directly; the value stays on the device until it is read.
//!
//! ```no_run
//! # use fled_core::{image::Image, reconstruct::loss::{GpuTarget, Loss, Noise}};
//! # fn main() -> Result<(), fled_gpu::GpuError> {
//! # let (gpu, image) = (fled_gpu::Gpu::new("auto")?, Image::new(280, 160));
//! let target = GpuTarget::upload(&gpu, &image, &Noise::NONE)?;      // once per view and size
//! let loss = Loss::new(&gpu, 280, 160)?;                            // once per size
//! let prediction = gpu.create::<f32>("prediction", 3 * 280 * 160)?; // planar [3, H, W]
//! let gradient = gpu.create::<f32>("gradient", 3 * 280 * 160)?;     // the same; overwritten
//! let mut recorder = gpu.recorder();
//! loss.record(&mut recorder, &prediction, &target, &gradient)?;     // two dispatches
//! recorder.submit()?;
//! println!("{:?}", loss.value()?);                                  // of the last step; waits
//! # Ok(())
//! # }
//! ```

pub mod reference;

use bytemuck::{Pod, Zeroable};
pub use fled_cpu::loss::Noise;
use fled_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder, read, read_write, uniform};

use crate::image::Image;
use crate::mask::Mask;
use crate::noise_levels::LEVELS;

/// Weight of the mean absolute error; the usual share for splats.
pub const L1_SHARE: f64 = 0.8;

/// Weight of `1 - SSIM`.
pub const SSIM_SHARE: f64 = 0.2;

/// `COLUMNS` of shaders/shared/loss.wgsl.
const COLUMNS: u32 = 4;

/// Rows that an invocation walks down. It reads ten rows more, so a long run wastes less, but makes
/// fewer invocations.
const RUN: u32 = 8;

const SIMILARITY: Kernel = Kernel::new(
    "train/loss_similarity",
    &[
        uniform("size"),
        uniform("noise"),
        read("prediction"),
        read("truth"),
        read_write("derivatives"),
        read_write("similarity_sums"),
    ],
);

const GRADIENT: Kernel = Kernel::new(
    "train/loss_gradient",
    &[
        uniform("size"),
        read("prediction"),
        read("truth"),
        read("derivatives"),
        read_write("gradient"),
        read_write("error_sums"),
    ],
);

const FILL: Kernel = Kernel::new(
    "train/mask_fill",
    &[uniform("size"), read("prediction"), read("truth"), read("kept"), read_write("filled")],
);

const MASK_GRADIENT: Kernel =
    Kernel::new("train/mask_gradient", &[uniform("size"), read("kept"), read_write("gradient")]);

/// `LossUniform` of shaders/shared/loss.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
struct LossUniform {
    width: u32,
    height: u32,
    run: u32,
    blocks_x: u32,
    blocks_y: u32,
    l1_weight: f32,
    ssim_weight: f32,
    values: u32,
}

/// `NoiseUniform` of shaders/train/loss_similarity.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
struct NoiseUniform {
    bends: [f32; LEVELS],
    first: f32,
    pad: [u32; 3],
}

impl NoiseUniform {
    fn new(noise: &Noise) -> Self {
        let Noise { first, bends } = *noise;
        Self { bends, first, pad: [0; 3] }
    }
}

impl LossUniform {
    fn new(width: usize, height: usize) -> Self {
        let values = 3 * width * height;
        Self {
            width: width as u32,
            height: height as u32,
            run: RUN,
            blocks_x: (width as u32).div_ceil(COLUMNS),
            blocks_y: (height as u32).div_ceil(RUN),
            l1_weight: (L1_SHARE / values as f64) as f32,
            ssim_weight: (SSIM_SHARE / values as f64) as f32,
            values: values as u32,
        }
    }

    fn invocations(&self) -> usize {
        3 * (self.blocks_x * self.blocks_y) as usize
    }
}

/// The value of the loss and of its parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossValue {
    /// `0.8 l1 + 0.2 (1 - ssim)`.
    pub total: f64,
    /// Mean absolute error.
    pub l1: f64,
    /// Mean structural similarity, zero-padded.
    pub ssim: f64,
    /// Mean squared error of the unclipped prediction.
    pub squared: f64,
}

/// The loss of images of one size, with the buffers between its two kernels.
pub struct Loss {
    layout: LossUniform,
    size: Buffer<LossUniform>,
    derivatives: Buffer<[f32; 4]>,
    similarity_sums: Buffer<f32>,
    error_sums: Buffer<[f32; 2]>,
    /// The prediction with the target in masked pixels; `None` for views without masks.
    filled: Option<Buffer<f32>>,
}

impl Loss {
    /// The loss for images of `width` x `height` px.
    ///
    /// # Errors
    /// A device error, typically out of memory.
    pub fn new(gpu: &Gpu, width: usize, height: usize) -> Result<Self, GpuError> {
        let layout = LossUniform::new(width, height);
        let values = layout.values as usize;
        Ok(Self {
            layout,
            size: gpu.upload("loss size", &[layout])?,
            derivatives: gpu.create("similarity derivatives", values)?,
            similarity_sums: gpu.create("similarity sums", layout.invocations())?,
            error_sums: gpu.create("error sums", layout.invocations())?,
            filled: None,
        })
    }

    /// Makes room for [`Loss::record_masked`].
    ///
    /// # Errors
    /// A device error, typically out of memory.
    pub fn make_masks(&mut self, gpu: &Gpu) -> Result<(), GpuError> {
        if self.filled.is_none() {
            self.filled = Some(gpu.create("masked prediction", self.layout.values as usize)?);
        }
        Ok(())
    }

    /// Records the loss of `prediction` (planar [3, H, W]) against `target`, and overwrites
    /// `gradient` ([3, H, W]) with the derivative of the loss by the prediction. Buffers may be
    /// longer than the image.
    ///
    /// # Errors
    /// [`GpuError::Validation`] when a buffer is shorter than the image; a device error.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        prediction: &Buffer<f32>,
        target: &GpuTarget,
        gradient: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        let values = self.layout.values as usize;
        let GpuTarget { values: truth, noise } = target;
        let lengths = [prediction.len(), 2 * truth.len(), gradient.len()];
        if lengths.iter().any(|&length| length < values) {
            return Err(GpuError::Validation(format!(
                "a loss of {values} values on buffers of {lengths:?}"
            )));
        }
        let invocations = self.layout.invocations();
        recorder.dispatch_items(
            &SIMILARITY,
            &[&self.size, noise, prediction, truth, &self.derivatives, &self.similarity_sums],
            invocations,
        )?;
        recorder.dispatch_items(
            &GRADIENT,
            &[&self.size, prediction, truth, &self.derivatives, gradient, &self.error_sums],
            invocations,
        )
    }

    /// [`Loss::record`] without the pixels that are not in `kept` (from [`upload_mask`]): there the
    /// prediction is taken to be the target, so it has no error, and its gradient is 0. Means are
    /// over all pixels.
    ///
    /// # Errors
    /// [`GpuError::Validation`] when a buffer is shorter than the image, or without
    /// [`Loss::make_masks`]; a device error.
    pub fn record_masked(
        &self,
        recorder: &mut Recorder,
        prediction: &Buffer<f32>,
        (target, kept): (&GpuTarget, &Buffer<u32>),
        gradient: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        let values = self.layout.values as usize;
        let Some(filled) = self.filled.as_ref().filter(|_| 32 * kept.len() >= values / 3) else {
            return Err(GpuError::Validation(format!(
                "a masked loss of {values} values without room for them"
            )));
        };
        let truth = &target.values;
        recorder.dispatch_items(&FILL, &[&self.size, prediction, truth, kept, filled], values)?;
        self.record(recorder, filled, target, gradient)?;
        recorder.dispatch_items(&MASK_GRADIENT, &[&self.size, kept, gradient], values)
    }

    /// The value of the last submitted loss. Waits for the device. The partial sums are added in a
    /// fixed order, so the same images give the same bits.
    ///
    /// # Errors
    /// A device error.
    pub fn value(&self) -> Result<LossValue, GpuError> {
        let n = f64::from(self.layout.values);
        let ssim = self.similarity_sums.read()?.into_iter().map(f64::from).sum::<f64>() / n;
        let errors = self.error_sums.read()?;
        let absolute = errors.iter().map(|[absolute, _]| f64::from(*absolute));
        let squares = errors.iter().map(|[_, square]| f64::from(*square));
        let (l1, squared) = (absolute.sum::<f64>() / n, squares.sum::<f64>() / n);
        Ok(LossValue { total: L1_SHARE * l1 + SSIM_SHARE * (1.0 - ssim), l1, ssim, squared })
    }
}

/// Packs an image for the loss: planar, clipped to 0..=1, 16 bits per value, two values per word,
/// the first in the lower half. Eight bits would show as bands after a tone curve.
pub fn pack_target(image: &Image) -> Vec<u32> {
    let half = |value: Option<&f32>| value.map_or(0, |&value| u32::from(quantised(value)));
    let pairs = image.data().chunks(2);
    pairs.map(|pair| half(pair.first()) | half(pair.get(1)) << 16).collect()
}

/// A value clipped to 0..=1, in units of 1/65535.
pub fn quantised(value: f32) -> u16 {
    (value.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16
}

/// Packs a mask for the loss: a bit per pixel, row by row, 32 per word, the first in the lowest.
pub fn pack_mask(mask: &Mask) -> Vec<u32> {
    let word = |pixels: &[bool]| {
        let bits = pixels.iter().enumerate();
        bits.fold(0, |word, (at, &holds)| word | u32::from(holds) << at)
    };
    mask.pixels().chunks(32).map(word).collect()
}

/// [`pack_mask`] into a buffer.
///
/// # Errors
/// A device error.
pub fn upload_mask(gpu: &Gpu, mask: &Mask) -> Result<Buffer<u32>, GpuError> {
    gpu.upload("mask", &pack_mask(mask))
}

/// A photograph on the device, with its noise.
pub struct GpuTarget {
    /// From [`pack_target`].
    values: Buffer<u32>,
    noise: Buffer<NoiseUniform>,
}

impl GpuTarget {
    /// # Errors
    /// A device error.
    pub fn upload(gpu: &Gpu, image: &Image, noise: &Noise) -> Result<Self, GpuError> {
        Ok(Self {
            values: gpu.upload("target", &pack_target(image))?,
            noise: gpu.upload("noise", &[NoiseUniform::new(noise)])?,
        })
    }
}

#[cfg(test)]
mod tests;
