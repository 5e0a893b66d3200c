//! The loss of a training step, a weighted sum of the mean absolute error and of 1 - SSIM, and its
//! gradient.
//!
//! SSIM has an 11 x 11 Gaussian window of sigma 1.5 and is zero-padded. Its second constant grows
//! with the noise of the target. Bands of rows are tasks: each blurs its rows and five more on
//! either side horizontally, then vertically.

mod blur;
mod noise;

use fearless_simd::prelude::*;
use rayon::prelude::*;

use crate::simd::{F, LANES, each, load, load_some, ramp, splat, store_some, sum, vectorised};
use blur::Blurred;
pub use noise::{LEVELS, Noise};

/// (0.01)^2 and (0.03)^2 of Wang et al. 2004, data range 1.
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

/// Rows of a band. Its blurred rows, four numbers a pixel, lie in the second cache.
const BAND: usize = 32;

/// Means over all values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossMeans {
    /// Absolute error.
    pub absolute: f64,
    /// Squared error.
    pub squared: f64,
    /// Structural similarity, zero-padded.
    pub similarity: f64,
}

/// The shares of the two parts in the loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares {
    /// Of the mean absolute error.
    pub absolute: f64,
    /// Of 1 - SSIM.
    pub similarity: f64,
}

/// A loss with its buffers.
#[derive(Debug, Default)]
pub struct Loss {
    /// Derivatives of the similarity by three moments of its window, [3, height, 3, stride].
    derivatives: Vec<f32>,
    /// The prediction with the target in masked pixels.
    filled: Vec<f32>,
}

/// A photograph that a prediction is compared with.
#[derive(Clone, Copy, Debug)]
pub struct Target<'a> {
    /// Planar [3, height, width], in units of 1/65535.
    pub values: &'a [u16],
    /// Width and height, px.
    pub size: [usize; 2],
    pub noise: &'a Noise,
}

/// One channel of an image and of its target, with the size in px.
#[derive(Clone, Copy)]
struct Plane<'a> {
    prediction: &'a [f32],
    target: &'a [u16],
    size: [usize; 2],
    noise: &'a Noise,
}

impl<'a> Plane<'a> {
    /// A row of the prediction and of the target.
    fn row(&self, row: usize) -> (&'a [f32], &'a [u16]) {
        let range = row * self.size[0]..(row + 1) * self.size[0];
        (&self.prediction[range.clone()], &self.target[range])
    }
}

/// Whole vectors that hold a row.
fn stride(width: usize) -> usize {
    width.next_multiple_of(LANES)
}

fn unpacked(value: u16) -> f32 {
    f32::from(value) * (1.0 / 65_535.0)
}

impl Loss {
    /// The means for a prediction, planar [3, height, width]. Overwrites `gradient` with the
    /// derivative of the loss by the prediction.
    pub fn run(
        &mut self,
        prediction: &[f32],
        target: Target<'_>,
        shares: Shares,
        gradient: &mut [f32],
    ) -> LossMeans {
        let Target { values: target, size, noise } = target;
        let [width, height] = size;
        let (pixels, row) = (width * height, 3 * stride(width));
        if pixels == 0 {
            return LossMeans::default();
        }
        self.derivatives.resize(3 * height * row, 0.0);
        let planes: Vec<_> =
            prediction.chunks_exact(pixels).zip(target.chunks_exact(pixels)).collect();
        let planes = planes.into_iter().map(|(prediction, target)| Plane {
            prediction,
            target,
            size,
            noise,
        });
        let planes: Vec<_> = planes.collect();
        let tasks = bands(&planes, &mut self.derivatives, height * row, BAND * row);
        let similarities: Vec<f64> = tasks
            .into_par_iter()
            .map_init(|| Blurred::new(size[0], 4), |blurred, (plane, first, derivatives)| {
                vectorised!(simd => similarity_band(simd, plane, first, blurred, derivatives))
            })
            .collect();
        let values = 3.0 * pixels as f64;
        let weights = [shares.absolute / values, shares.similarity / values].map(|w| w as f32);
        let derivatives: Vec<_> = self.derivatives.chunks_exact(height * row).collect();
        let tasks = bands(&derivatives, gradient, pixels, BAND * width).into_iter().zip(0..);
        let per_plane = height.div_ceil(BAND);
        let errors: Vec<[f64; 2]> = tasks
            .collect::<Vec<_>>()
            .into_par_iter()
            .map_init(
                || Blurred::new(size[0], 3),
                |blurred, ((derivatives, first, out), task)| {
                    let input = (planes[task / per_plane], derivatives);
                    vectorised!(simd => gradient_band(simd, input, first, (blurred, weights), out))
                },
            )
            .collect();
        let mean = |n: usize| errors.iter().map(|sums| sums[n]).sum::<f64>() / values;
        let similarity = similarities.into_iter().sum::<f64>() / values;
        LossMeans { absolute: mean(0), squared: mean(1), similarity }
    }
}

impl Loss {
    /// [`Loss::run`] without the pixels that are not `kept`, [height, width]: there the prediction
    /// is taken to be the target, so it has no error, and its gradient is 0. Means are over all
    /// pixels.
    pub fn run_masked(
        &mut self,
        prediction: &[f32],
        target: Target<'_>,
        kept: &[bool],
        shares: Shares,
        gradient: &mut [f32],
    ) -> LossMeans {
        let mut filled = std::mem::take(&mut self.filled);
        filled.clear();
        let masked = || kept.iter().cycle();
        let pairs = prediction.iter().zip(target.values).zip(masked());
        filled.extend(pairs.map(|((p, t), kept)| if *kept { *p } else { unpacked(*t) }));
        let means = self.run(&filled, target, shares, gradient);
        self.filled = filled;
        let outside = gradient.iter_mut().zip(masked()).filter(|(_, kept)| !**kept);
        outside.for_each(|(gradient, _)| *gradient = 0.0);
        means
    }
}

/// Inputs of the three planes, first rows, and outputs of all bands in order.
fn bands<'a, T: Copy>(
    planes: &[T],
    out: &'a mut [f32],
    plane: usize,
    band: usize,
) -> Vec<(T, usize, &'a mut [f32])> {
    let planes = planes.iter().zip(out.chunks_exact_mut(plane));
    let bands = planes.flat_map(|(&input, out)| {
        out.chunks_mut(band).enumerate().map(move |(n, out)| (input, n * BAND, out))
    });
    bands.collect()
}

/// Writes the derivatives of a band; the sum of its similarities.
#[inline(always)]
fn similarity_band<S: Simd>(
    simd: S,
    plane: Plane<'_>,
    first: usize,
    blurred: &mut Blurred,
    derivatives: &mut [f32],
) -> f64 {
    let [width, height] = plane.size;
    let rows = derivatives.len() / (3 * stride(width));
    blurred.fill(
        simd,
        (first, rows, height),
        #[inline(always)]
        |row, lines| {
            let (prediction, target) = plane.row(row);
            let [x, y, squares, product] = lines else { return };
            let pairs = prediction.iter().zip(target).zip(x.iter_mut()).zip(y.iter_mut());
            let pairs = pairs.zip(squares.iter_mut()).zip(product.iter_mut());
            for (((((&p, &t), x), y), squares), product) in pairs {
                let t = unpacked(t);
                (*x, *y) = (p, t);
                *squares = p.mul_add(p, t * t);
                *product = p * t;
            }
        },
    );
    let mut total = 0.0;
    for (row, out) in derivatives.chunks_exact_mut(3 * stride(width)).enumerate() {
        let mut row_sum = splat(simd, 0.0);
        for x in (0..width).step_by(LANES) {
            let moments = each!([0, 1, 2, 3] n => blurred.at(simd, n, row, x));
            let inside = (ramp(simd) + x as f32).simd_lt(width as f32);
            let values = similarity(moments, plane.noise.at(moments[1]));
            let zero = splat(simd, 0.0);
            row_sum += inside.select(values[0], zero);
            for n in 0..3 {
                inside
                    .select(values[n + 1], zero)
                    .store_slice(&mut out[n * stride(width) + x..][..LANES]);
            }
        }
        total += f64::from(sum(row_sum));
    }
    total
}

/// Similarity, and its derivatives by the means of x, x^2 and x y, from the means of x, y,
/// x^2 + y^2 and x y, and from the standard deviation of the noise of y.
#[inline(always)]
fn similarity<S: Simd>([x, y, squares, product]: [F<S>; 4], noise: F<S>) -> [F<S>; 4] {
    let one = splat(x.witness(), 1.0);
    let c2 = (noise * 2.0).mul_add(noise, splat(x.witness(), C2));
    let both = x * y;
    let a1 = both * 2.0 + C1;
    let a2 = (product - both) * 2.0 + c2;
    let square = x.mul_add(x, y * y);
    let b1 = square + C1;
    let b2 = squares - square + c2;
    let inverse = one / (b1 * b2);
    let s = a1 * a2 * inverse;
    let by_mean = (y * (a2 - a1) + x * s * (b1 - b2)) * inverse * 2.0;
    [s, by_mean, -s / b2, a1 * inverse * 2.0]
}

/// Writes the gradient of a band; its sums of absolute and squared errors.
#[inline(always)]
fn gradient_band<S: Simd>(
    simd: S,
    (plane, derivatives): (Plane<'_>, &[f32]),
    first: usize,
    (blurred, [l1, ssim]): (&mut Blurred, [f32; 2]),
    out: &mut [f32],
) -> [f64; 2] {
    let [width, height] = plane.size;
    let stride = stride(width);
    blurred.fill(simd, (first, out.len() / width, height), |row, lines| {
        for (n, line) in lines.iter_mut().enumerate() {
            let from = (3 * row + n) * stride;
            line[..width].copy_from_slice(&derivatives[from..from + width]);
        }
    });
    let mut total = [0.0; 2];
    for (row, out) in out.chunks_exact_mut(width).enumerate() {
        let (prediction, target) = plane.row(first + row);
        let mut sums = [splat(simd, 0.0); 2];
        for x in (0..width).step_by(LANES) {
            let end = (x + LANES).min(width);
            let mut t = [0.0; LANES];
            for (t, &packed) in t.iter_mut().zip(&target[x..end]) {
                *t = unpacked(packed);
            }
            let (p, t) = (load_some(simd, &prediction[x..end]), load(simd, &t));
            let [by_mean, by_square, by_product] =
                each!([0, 1, 2] n => blurred.at(simd, n, row, x));
            let similarity = t.mul_add(by_product, (p * 2.0).mul_add(by_square, by_mean));
            let error = p - t;
            let (zero, one) = (splat(simd, 0.0), splat(simd, l1));
            let below = error.simd_lt(0.0).select(-one, zero);
            let sign = error.simd_gt(0.0).select(one, below);
            store_some(similarity.mul_add(-ssim, sign), &mut out[x..end]);
            sums = [sums[0] + error.abs(), error.mul_add(error, sums[1])];
        }
        for n in 0..2 {
            total[n] += f64::from(sum(sums[n]));
        }
    }
    total
}
