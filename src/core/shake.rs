//! The shake of each training view: a small kernel that blurs the sharp render before it is
//! compared with the photograph, so that the scene need not be as blurred as its training views.
//!
//! Differs from the paper, which leaves all of the blur to the network: the blur that the network
//! leaves in D_j is modelled here, `I_pred = f(k_j * f^-1(I_r)) + n`, f the [`Response`]. The
//! kernels differ from view to view and the scene does not, so the sharp scene is what all views
//! share. The optimiser does not learn `k_j`: [`estimate`] solves for it periodically from the
//! renders.

mod denoise;
mod estimate;
mod kernels;
mod processor;
mod reference;
mod response;
mod saved;

use std::collections::BTreeMap;

use fled_gpu::{Buffer, Gpu, GpuError, Recorder};

pub use denoise::denoised;
pub use estimate::{estimate, estimate_by_cells};
use kernels::ShakeUniform;
pub use processor::shaken_image;
pub use response::Response;
pub use saved::{parse, save};

/// Most taps of a kernel on the device; beyond these, the smallest are dropped.
pub const MOST_TAPS: usize = 160;

/// Cells of a kernel along the longer side of its image.
const ALONG: usize = 3;
/// All cells of a kernel; two lie along the shorter side.
pub const CELLS: usize = 2 * ALONG;

/// Weight of the total variation of the sharp render, beside 0.8 of the mean absolute error.
/// Without it, detail that the shake hides from every view is unconstrained: it grows into
/// elongated Gaussians, and the kernels with it.
pub(crate) const SMOOTH_WEIGHT: f64 = 0.05;
/// Difference well below which the penalty is quadratic, so that smooth shading is free. `BEND` of
/// the shader.
pub(crate) const SMOOTH_BEND: f64 = 0.02;

/// Least elongation of a kernel that shows a significant shake, px, at a longer side of
/// [`SIGNIFICANT_SIDE`] (docs/decisions/shake.md).
const SIGNIFICANT_FROM: f64 = 1.5;
const SIGNIFICANT_SIDE: f64 = 560.0;

/// One tap: moves a share of the light by `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tap {
    /// Offset, px.
    pub offset: [i32; 2],
    /// Share of the light in each cell, not negative; in each cell all taps sum to 1. Three cells
    /// along the longer side of the image come first, then the three below or right of them.
    pub weights: [f32; CELLS],
}

impl Tap {
    /// A tap that is the same in all cells.
    pub fn even(offset: [i32; 2], weight: f32) -> Self {
        Self { offset, weights: [weight; CELLS] }
    }

    /// Mean share of the light over the cells.
    pub fn weight(&self) -> f32 {
        self.weights.iter().sum::<f32>() / CELLS as f32
    }

    /// Largest share of the light in a cell.
    fn most(&self) -> f32 {
        self.weights.iter().copied().fold(0.0, f32::max)
    }

    /// Share of the light that arrives at a pixel of an image of `size` = [width, height] px,
    /// linear between the middles of the cells.
    pub fn weight_at(&self, pixel: [usize; 2], size: [usize; 2]) -> f64 {
        let (long, short) = if size[0] >= size[1] { (0, 1) } else { (1, 0) };
        let place = |axis: usize, cells: usize| {
            let share = (pixel[axis] as f64 + 0.5) / size[axis] as f64;
            (share * cells as f64 - 0.5).clamp(0.0, (cells - 1) as f64)
        };
        let (along, across) = (place(long, ALONG), place(short, CELLS / ALONG));
        let near = |at: f64, cell: usize| (1.0 - (at - cell as f64).abs()).max(0.0);
        let term = |(cell, weight): (usize, &f32)| {
            near(along, cell % ALONG) * near(across, cell / ALONG) * f64::from(*weight)
        };
        self.weights.iter().enumerate().map(term).sum()
    }
}

/// The shake of one photograph: a blur of its light that varies slowly over the image.
#[derive(Clone, Debug, PartialEq)]
pub struct ShakeKernel {
    taps: Vec<Tap>,
}

impl ShakeKernel {
    /// No shake.
    pub fn still() -> Self {
        Self { taps: vec![Tap::even([0, 0], 1.0)] }
    }

    /// The largest [`MOST_TAPS`] taps, normalised in each cell; [`ShakeKernel::still`] if a cell
    /// has none.
    pub fn new(mut taps: Vec<Tap>) -> Self {
        taps.retain(|tap| {
            tap.weights.iter().all(|w| w.is_finite() && *w >= 0.0) && tap.most() > 0.0
        });
        taps.sort_by(|a, b| b.most().total_cmp(&a.most()).then(a.offset.cmp(&b.offset)));
        taps.truncate(MOST_TAPS);
        let sums: [f32; CELLS] =
            std::array::from_fn(|cell| taps.iter().map(|tap| tap.weights[cell]).sum());
        if !sums.iter().all(|sum| sum.is_finite() && *sum > 0.0) {
            return Self::still();
        }
        for tap in &mut taps {
            tap.weights.iter_mut().zip(sums).for_each(|(weight, sum)| *weight /= sum);
        }
        Self { taps }
    }

    /// The taps, the largest first.
    pub fn taps(&self) -> &[Tap] {
        &self.taps
    }

    /// Mean offset of the light, px.
    pub fn centroid(&self) -> [f64; 2] {
        [0, 1].map(|axis| {
            self.taps.iter().map(|tap| f64::from(tap.weight()) * f64::from(tap.offset[axis])).sum()
        })
    }

    /// Root mean square distance of the light from its centroid, px.
    pub fn spread(&self) -> f64 {
        let centre = self.centroid();
        let squared = |tap: &Tap| {
            (0..2).map(|axis| (f64::from(tap.offset[axis]) - centre[axis]).powi(2)).sum::<f64>()
        };
        self.taps.iter().map(|tap| f64::from(tap.weight()) * squared(tap)).sum::<f64>().sqrt()
    }

    /// The square root of the difference of the light's variances along and across the kernel, px.
    /// Errors of a render and noise widen a kernel equally in all directions, by 0.7 to 0.9 px; a
    /// hand moves along a path.
    pub fn elongation(&self) -> f64 {
        let centre = self.centroid();
        let moment = |one: usize, other: usize| -> f64 {
            let term = |tap: &Tap| {
                let away = |axis: usize| f64::from(tap.offset[axis]) - centre[axis];
                f64::from(tap.weight()) * away(one) * away(other)
            };
            self.taps.iter().map(term).sum()
        };
        let difference = moment(0, 0) - moment(1, 1);
        difference.hypot(2.0 * moment(0, 1)).sqrt()
    }

    /// [`ShakeKernel::elongation`] relative to the least one of a significant shake in images with
    /// this longer side, px. A shake grows with the image and noise does not: the least one grows
    /// with the square root of the side, which lies between the two.
    pub fn significance(&self, longer_side: usize) -> f64 {
        self.elongation() / (SIGNIFICANT_FROM * (longer_side as f64 / SIGNIFICANT_SIDE).sqrt())
    }

    /// The kernel of the image at half the size.
    #[must_use]
    pub fn halved(&self) -> Self {
        let mut taps: BTreeMap<[i32; 2], [f32; CELLS]> = BTreeMap::new();
        for tap in &self.taps {
            // An odd offset lies between two pixels of the smaller image.
            for [dx, dy] in [[0, 0], [0, 1], [1, 0], [1, 1]] {
                let offset = [tap.offset[0] + dx, tap.offset[1] + dy].map(|o| o.div_euclid(2));
                add(taps.entry(offset).or_default(), tap, 0.25);
            }
        }
        let taps = taps.into_iter();
        Self::new(taps.map(|(offset, weights)| Tap { offset, weights }).collect())
    }

    /// The kernel of the image at twice the size: each tap becomes a tent of nine.
    #[must_use]
    fn doubled(&self) -> Self {
        let mut taps: BTreeMap<[i32; 2], [f32; CELLS]> = BTreeMap::new();
        let share = |away: i32| if away == 0 { 0.5 } else { 0.25 };
        for tap in &self.taps {
            for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                let offset = [2 * tap.offset[0] + dx, 2 * tap.offset[1] + dy];
                add(taps.entry(offset).or_default(), tap, share(dx) * share(dy));
            }
        }
        let taps = taps.into_iter();
        Self::new(taps.map(|(offset, weights)| Tap { offset, weights }).collect())
    }

    /// Two rows a tap: the weights of three cells each, then one of its offsets.
    fn rows(&self) -> Vec<[f32; 4]> {
        let rows = |tap: &Tap| {
            let [a, b, c, d, e, f] = tap.weights;
            let [x, y] = tap.offset.map(|o| o as f32);
            [[a, b, c, x], [d, e, f, y]]
        };
        self.taps.iter().flat_map(rows).collect()
    }
}

fn add(weights: &mut [f32; CELLS], tap: &Tap, share: f32) {
    weights.iter_mut().zip(tap.weights).for_each(|(sum, weight)| *sum += share * weight);
}

/// Applies shake to renders on the device: the views' common [`Response`], and the state between
/// the forward and backward pass of one of them.
pub struct Shake {
    response: Response,
    knots: Buffer<f32>,
    light: Buffer<[f32; 4]>,
    factor: Buffer<[f32; 4]>,
    blurred: Buffer<f32>,
    render_gradient: Buffer<f32>,
}

/// The kernel of one view, on the device.
pub struct DeviceKernel {
    kernel: ShakeKernel,
    uniform: Buffer<ShakeUniform>,
    taps: Buffer<[f32; 4]>,
    pixels: usize,
}

impl DeviceKernel {
    /// Allocates the kernel of a view; [`Shake::set`] fills it.
    ///
    /// # Errors
    /// A device error, typically out of memory.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: ShakeKernel::still(),
            uniform: gpu.create("shake", 1)?,
            taps: gpu.create("shake taps", 2 * MOST_TAPS)?,
            pixels: 0,
        })
    }

    /// Whether it was set to this kernel for images of this size, px.
    pub fn is_set_to(&self, kernel: &ShakeKernel, size: [usize; 2]) -> bool {
        self.kernel == *kernel && self.pixels == size[0] * size[1]
    }
}

impl Shake {
    /// For views of one `response` with images of at most `size` = [width, height] px.
    ///
    /// # Errors
    /// A device error, typically out of memory.
    pub fn new(gpu: &Gpu, size: [usize; 2], response: &Response) -> Result<Self, GpuError> {
        let pixels = size[0] * size[1];
        Ok(Self {
            response: response.clone(),
            knots: gpu.upload("shake response", response.knots())?,
            light: gpu.create("shake light", pixels)?,
            factor: gpu.create("shake factor", pixels)?,
            blurred: gpu.create("shaken render", 3 * pixels)?,
            render_gradient: gpu.create("render gradient", 3 * pixels)?,
        })
    }

    /// The response from light to the views' values.
    pub fn response(&self) -> &Response {
        &self.response
    }

    /// Whether it has room for images of this size, px.
    pub fn fits(&self, size: [usize; 2]) -> bool {
        size[0] * size[1] <= self.light.len()
    }

    /// Sets the kernel of `view` from the next submission on, at its image's size in px. Recordings
    /// stay valid as long as the size does not change.
    ///
    /// # Errors
    /// [`GpuError::Validation`] for an image larger than those of [`Shake::new`]; a device error.
    pub fn set(
        &self,
        view: &mut DeviceKernel,
        size: [usize; 2],
        kernel: ShakeKernel,
    ) -> Result<(), GpuError> {
        let pixels = size[0] * size[1];
        if !self.fits(size) {
            return Err(GpuError::Validation(format!(
                "shake made too small for {}x{}",
                size[0], size[1]
            )));
        }
        view.uniform.write(&[ShakeUniform {
            width: size[0] as u32,
            height: size[1] as u32,
            taps: kernel.taps.len() as u32,
            smooth_weight: (SMOOTH_WEIGHT / (3 * pixels) as f64) as f32,
        }])?;
        view.taps.write_at(0, &kernel.rows())?;
        (view.kernel, view.pixels) = (kernel, pixels);
        Ok(())
    }

    /// The shaken render, planar [3, H, W], after [`Shake::record_forward`].
    pub fn blurred(&self) -> &Buffer<f32> {
        &self.blurred
    }

    /// The derivative of the loss by the render, planar [3, H, W], after
    /// [`Shake::record_backward`].
    pub fn render_gradient(&self) -> &Buffer<f32> {
        &self.render_gradient
    }

    /// Records the shaking of `render`, planar [3, H, W].
    ///
    /// # Errors
    /// A device error.
    pub fn record_forward(
        &self,
        recorder: &mut Recorder,
        view: &DeviceKernel,
        render: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        recorder.dispatch_items(
            &kernels::LINEARISE,
            &[&view.uniform, &self.knots, render, &self.light],
            view.pixels,
        )?;
        recorder.dispatch_items(
            &kernels::BLUR,
            &[&view.uniform, &view.taps, &self.knots, &self.light, &self.blurred, &self.factor],
            view.pixels,
        )
    }

    /// Records the backward pass from `gradient`, the derivative by [`Shake::blurred`], to
    /// [`Shake::render_gradient`]. Requires and consumes the state of the forward pass of the same
    /// view.
    ///
    /// # Errors
    /// A device error.
    pub fn record_backward(
        &self,
        recorder: &mut Recorder,
        view: &DeviceKernel,
        render: &Buffer<f32>,
        gradient: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        recorder.dispatch_items(
            &kernels::SCALE,
            &[&view.uniform, gradient, &self.factor],
            view.pixels,
        )?;
        recorder.dispatch_items(
            &kernels::BLUR_BACKWARD,
            &[&view.uniform, &view.taps, &self.knots, &self.factor, render, &self.render_gradient],
            view.pixels,
        )
    }
}

#[cfg(test)]
mod tests;
