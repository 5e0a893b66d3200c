//! The shake of a view: a blur of its light by a small kernel that varies over the image by 3 x 2
//! cells, and the backward pass. The reference is the core's src/core/shake/reference.rs.

mod response;

use fearless_simd::f32x16;
use fearless_simd::prelude::*;
use rayon::prelude::*;

use crate::simd::{F, LANES, each, splat, store_some, vectorised};
pub use response::{KNOTS, Response};

/// Cells along the longer side.
const ALONG: usize = 3;
/// Rows of a task.
const BAND: usize = 16;

/// One tap: moves a share of the light by `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tap {
    /// px.
    pub offset: [i32; 2],
    /// Share in each cell: three along the longer side, then the three below or right of them.
    pub weights: [f32; 2 * ALONG],
}

/// The kernel of a view for images of one size.
#[derive(Clone, Debug, PartialEq)]
pub struct Kernel {
    taps: Vec<Tap>,
    size: [usize; 2],
    /// Columns of zeros on either side of a row: no tap reaches farther.
    margin: usize,
    /// Three functions of the column, by which a row's weights vary, [3, stride].
    columns: Vec<f32>,
}

/// Weight of each cell at a place, given in cells from the middle of the first.
fn near(pixel: usize, pixels: usize, cells: usize) -> [f32; ALONG] {
    let at = (pixel as f32 + 0.5) / pixels as f32 * cells as f32 - 0.5;
    let at = at.max(0.0).min((cells - 1) as f32);
    std::array::from_fn(|cell| (1.0 - (at - cell as f32).abs()).max(0.0))
}

impl Kernel {
    /// For images of `size` px.
    pub fn new(taps: Vec<Tap>, size: [usize; 2]) -> Self {
        let reach = taps.iter().map(|tap| tap.offset[0].unsigned_abs() as usize).max();
        let margin = reach.unwrap_or(0).min(size[0]);
        // A tap beyond the image moves nothing.
        let inside =
            |tap: &Tap| (0..2).all(|n| (tap.offset[n].unsigned_abs() as usize) < size[n].max(1));
        let taps = taps.into_iter().filter(inside).collect();
        let mut out = Self { taps, size, margin, columns: Vec::new() };
        out.columns = vec![0.0; ALONG * out.stride()];
        let cells = if out.is_wide() { ALONG } else { 2 };
        for x in 0..size[0] {
            for (n, value) in near(x, size[0], cells).into_iter().enumerate() {
                let at = n * out.stride() + margin + x;
                out.columns[at] = value;
            }
        }
        out
    }

    fn is_wide(&self) -> bool {
        self.size[0] >= self.size[1]
    }

    fn stride(&self) -> usize {
        self.size[0].next_multiple_of(LANES) + 2 * self.margin
    }

    /// The factors of the three functions of the column in a tap's weight at a row.
    fn factors(&self, tap: &Tap, row: usize) -> [f32; ALONG] {
        let weights = &tap.weights;
        if self.is_wide() {
            let [first, second, _] = near(row, self.size[1], 2);
            return std::array::from_fn(|n| second.mul_add(weights[ALONG + n], first * weights[n]));
        }
        let near = near(row, self.size[1], ALONG);
        let cells =
            |first: usize| (0..ALONG).fold(0.0, |sum, n| weights[first + n].mul_add(near[n], sum));
        [cells(0), cells(ALONG), 0.0]
    }
}

/// A shake with its buffers.
#[derive(Debug, Default)]
pub struct Shake {
    /// Light of the render and ones, with margins of zeros, [4, height, stride].
    light: Vec<f32>,
    /// Derivative of the loss by the weighted sums of light, with margins, [3, height, stride].
    scaled: Vec<f32>,
    /// Derivative of the shaken render by those sums, [3, height, width].
    factor: Vec<f32>,
    /// The shaken render, planar [3, height, width].
    pub blurred: Vec<f32>,
    /// Derivative of the loss by the render, planar [3, height, width].
    pub render_gradient: Vec<f32>,
}

/// The contribution of a tap to a row: the start of its numbers, before column 0, and its factors.
struct Source {
    begin: usize,
    columns: usize,
    factors: [f32; ALONG],
}

/// The same bands of rows of several planes.
fn bands<'a>(planes: &'a mut [f32], plane: usize, band: usize) -> Vec<Vec<&'a mut [f32]>> {
    let mut out: Vec<Vec<&'a mut [f32]>> = Vec::new();
    for plane in planes.chunks_exact_mut(plane.max(1)) {
        for (n, band) in plane.chunks_mut(band.max(1)).enumerate() {
            match out.get_mut(n) {
                Some(bands) => bands.push(band),
                None => out.push(vec![band]),
            }
        }
    }
    out
}

impl Shake {
    /// Shakes `render`, planar [3, height, width], to [`Shake::blurred`].
    pub fn forward(&mut self, render: &[f32], kernel: &Kernel, response: &Response) {
        let ([width, height], stride) = (kernel.size, kernel.stride());
        let pixels = width * height;
        self.light.clear();
        self.light.resize(4 * stride * height, 0.0);
        let rows = self.light.par_chunks_mut(stride.max(1)).enumerate();
        rows.for_each(|(row, light)| {
            let light = &mut light[kernel.margin..][..width];
            if row >= 3 * height {
                return light.fill(1.0);
            }
            let render = &render[row * width..(row + 1) * width];
            vectorised!(_simd => for (light, value) in light.iter_mut().zip(render) {
                *light = response.light(*value);
            });
        });
        self.blurred.resize(3 * pixels, 0.0);
        self.factor.resize(3 * pixels, 0.0);
        let light = &self.light;
        let blurred = bands(&mut self.blurred, pixels, BAND * width);
        let factor = bands(&mut self.factor, pixels, BAND * width);
        let tasks = blurred.into_par_iter().zip(factor).enumerate();
        tasks.for_each(|(band, (mut blurred, mut factor))| {
            for n in 0..blurred[0].len() / width {
                let sources = kernel.sources(band * BAND + n, -1);
                let out = [&mut blurred, &mut factor].map(|planes| {
                    let rows = planes.iter_mut().map(|p| &mut p[n * width..(n + 1) * width]);
                    rows.collect::<Vec<_>>()
                });
                vectorised!(simd => blur_row(simd, kernel, &sources, light, (response, out)));
            }
        });
    }

    /// From the derivative by [`Shake::blurred`] to [`Shake::render_gradient`], after
    /// [`Shake::forward`] of the same render. Adds the derivative of `smooth[0]` times the total
    /// variation of the render, which is quadratic well below differences of `smooth[1]`.
    pub fn backward(
        &mut self,
        render: &[f32],
        gradient: &[f32],
        kernel: &Kernel,
        response: &Response,
        smooth: [f32; 2],
    ) {
        let ([width, height], stride) = (kernel.size, kernel.stride());
        let pixels = width * height;
        self.scaled.clear();
        self.scaled.resize(3 * stride * height, 0.0);
        let factor = &self.factor;
        let rows = self.scaled.par_chunks_mut(stride.max(1)).enumerate();
        rows.for_each(|(row, scaled)| {
            let range = row * width..(row + 1) * width;
            let pairs = factor[range.clone()].iter().zip(&gradient[range]);
            let scaled = &mut scaled[kernel.margin..][..width];
            scaled.iter_mut().zip(pairs).for_each(|(scaled, (a, b))| *scaled = a * b);
        });
        self.render_gradient.resize(3 * pixels, 0.0);
        let scaled = &self.scaled;
        let tasks = bands(&mut self.render_gradient, pixels, BAND * width);
        tasks.into_par_iter().enumerate().for_each(|(band, mut out)| {
            for n in 0..out[0].len() / width {
                let row = band * BAND + n;
                let sources = kernel.sources(row, 1);
                let rows = out.iter_mut().map(|plane| &mut plane[n * width..(n + 1) * width]);
                let mut rows: Vec<&mut [f32]> = rows.collect();
                vectorised!(simd => {
                    blur_row_back(simd, kernel, &sources, scaled, &mut rows);
                    for (channel, out) in rows.iter_mut().enumerate() {
                        let plane = &render[channel * pixels..(channel + 1) * pixels];
                        finish_row(plane, (row, width), response, smooth, out);
                    }
                });
            }
        });
    }
}

impl Kernel {
    /// The rows that the taps of a row read, at their offsets times `sign`.
    fn sources(&self, row: usize, sign: i32) -> Vec<Source> {
        let source = |tap: &Tap| {
            let [dx, dy] = tap.offset.map(|offset| sign * offset);
            let from = row.checked_add_signed(dy as isize)?;
            if from >= self.size[1] {
                return None;
            }
            // The weight is that of the pixel that receives the light.
            let arrival = if sign < 0 { row } else { from };
            let shifted = self.margin.checked_add_signed(dx as isize)?;
            Some(Source {
                begin: from * self.stride() + shifted,
                columns: if sign < 0 { self.margin } else { shifted },
                factors: self.factors(tap, arrival),
            })
        };
        self.taps.iter().filter_map(source).collect()
    }

    /// The weight of a source at the column `x` and those after it.
    #[inline(always)]
    fn weight<S: Simd>(&self, simd: S, source: &Source, x: usize) -> F<S> {
        let at = |n: usize| n * self.stride() + source.columns + x;
        let [a, b, c] = each!([0, 1, 2] n => vector(simd, &self.columns, at(n)));
        let [p, q, r] = source.factors;
        c.mul_add(r, b.mul_add(q, a * p))
    }
}

#[inline(always)]
fn vector<S: Simd>(simd: S, numbers: &[f32], at: usize) -> F<S> {
    f32x16::from_slice(simd, &numbers[at..at + LANES])
}

#[inline(always)]
fn blur_row<S: Simd>(
    simd: S,
    kernel: &Kernel,
    sources: &[Source],
    light: &[f32],
    (response, [mut blurred, mut factor]): (&Response, [Vec<&mut [f32]>; 2]),
) {
    let (width, plane) = (kernel.size[0], kernel.stride() * kernel.size[1]);
    for x in (0..width).step_by(LANES) {
        let mut sums = [splat(simd, 0.0); 4];
        for source in sources {
            let weight = kernel.weight(simd, source, x);
            for (n, sum) in sums.iter_mut().enumerate() {
                let light = vector(simd, light, n * plane + source.begin + x);
                *sum = weight.mul_add(light, *sum);
            }
        }
        let one = splat(simd, 1.0);
        let scale = sums[3].simd_gt(0.0).select(one / sums[3], splat(simd, 0.0));
        for channel in 0..3 {
            let (mut means, mut scales) = ([0.0; LANES], [0.0; LANES]);
            (sums[channel] * scale).store_slice(&mut means);
            scale.store_slice(&mut scales);
            let end = (x + LANES).min(width);
            let out = blurred[channel][x..end].iter_mut().zip(&mut factor[channel][x..end]);
            for ((blurred, factor), (mean, scale)) in out.zip(means.into_iter().zip(scales)) {
                let [value, slope] = response.value(mean);
                (*blurred, *factor) = (value, slope * scale);
            }
        }
    }
}

#[inline(always)]
fn blur_row_back<S: Simd>(
    simd: S,
    kernel: &Kernel,
    sources: &[Source],
    scaled: &[f32],
    out: &mut [&mut [f32]],
) {
    let (width, plane) = (kernel.size[0], kernel.stride() * kernel.size[1]);
    for x in (0..width).step_by(LANES) {
        let mut sums = [splat(simd, 0.0); 3];
        for source in sources {
            let weight = kernel.weight(simd, source, x);
            for (n, sum) in sums.iter_mut().enumerate() {
                let scaled = vector(simd, scaled, n * plane + source.begin + x);
                *sum = weight.mul_add(scaled, *sum);
            }
        }
        let end = (x + LANES).min(width);
        for (out, sum) in out.iter_mut().zip(sums) {
            store_some(sum, &mut out[x..end]);
        }
    }
}

/// From the derivative by light to that by the values of a row, with that of the total variation.
#[inline(always)]
fn finish_row(
    plane: &[f32],
    (row, width): (usize, usize),
    response: &Response,
    [weight, bend]: [f32; 2],
    out: &mut [f32],
) {
    let line = |row: usize| &plane[row * width..(row + 1) * width];
    let here = line(row);
    for (out, value) in out.iter_mut().zip(here) {
        *out *= response.light_slope(*value);
    }
    let bent = |d: f32| weight * d / d.mul_add(d, bend * bend).sqrt();
    let add = |out: &mut [f32], values: &[f32], others: &[f32]| {
        for ((out, value), other) in out.iter_mut().zip(values).zip(others) {
            *out += bent(value - other);
        }
    };
    add(&mut out[1..], &here[1..], here);
    add(out, here, &here[1..]);
    let others =
        [row.checked_sub(1), Some(row + 1).filter(|&row| (row + 1) * width <= plane.len())];
    for other in others.into_iter().flatten() {
        add(out, here, line(other));
    }
}
