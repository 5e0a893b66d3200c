//! The Gaussian window over the rows of a band.

use fearless_simd::f32x16;
use fearless_simd::prelude::*;

use super::{BAND, stride};
use crate::simd::{F, LANES, splat};

/// Taps on either side of the middle one.
pub(super) const RADIUS: usize = 5;

/// The Gaussian of 11 taps, sigma 1.5, normalised; symmetric, so 6 numbers.
const GAUSSIAN: [f32; 6] =
    [0.001_028_380_1, 0.007_598_758, 0.036_000_77, 0.109_360_69, 0.213_005_54, 0.266_011_72];

/// The rows of a band and five more on either side, blurred horizontally, with the lines that a row
/// is made of.
pub(super) struct Blurred {
    stride: usize,
    /// Numbers of a pixel.
    planes: usize,
    /// One row, with zeros left and right of it, [planes, stride + 2 RADIUS].
    lines: Vec<f32>,
    /// [BAND + 2 RADIUS, planes, stride].
    rows: Vec<f32>,
}

impl Blurred {
    pub(super) fn new(width: usize, planes: usize) -> Self {
        let stride = stride(width);
        Self {
            stride,
            planes,
            lines: vec![0.0; planes * (stride + 2 * RADIUS)],
            rows: vec![0.0; (BAND + 2 * RADIUS) * planes * stride],
        }
    }

    /// Blurs the band of `rows` rows from `first` on. `fill` writes a row of the image to the
    /// first numbers of each line; rows outside of `height` are zero.
    #[inline(always)]
    pub(super) fn fill<S: Simd>(
        &mut self,
        simd: S,
        (first, rows, height): (usize, usize, usize),
        mut fill: impl FnMut(usize, &mut [&mut [f32]]),
    ) {
        let line = self.stride + 2 * RADIUS;
        let outs = self.rows.chunks_exact_mut(self.planes * self.stride);
        for (n, out) in outs.enumerate().take(rows + 2 * RADIUS) {
            let row = first + n;
            if row < RADIUS || row - RADIUS >= height {
                out.fill(0.0);
                continue;
            }
            let mut lines: Vec<&mut [f32]> =
                self.lines.chunks_exact_mut(line).map(|line| &mut line[RADIUS..]).collect();
            fill(row - RADIUS, &mut lines);
            let lines = self.lines.chunks_exact(line);
            for (line, out) in lines.zip(out.chunks_exact_mut(self.stride)) {
                blur_line(simd, line, out);
            }
        }
    }

    /// The blurred numbers of a plane at a row of the band, from column `x` on.
    #[inline(always)]
    pub(super) fn at<S: Simd>(&self, simd: S, plane: usize, row: usize, x: usize) -> F<S> {
        let step = self.planes * self.stride;
        let first = row * step + plane * self.stride + x;
        let window = &self.rows[first..first + 2 * RADIUS * step + LANES];
        window_sum(
            simd,
            #[inline(always)]
            |n| f32x16::from_slice(simd, &window[n * step..n * step + LANES]),
        )
    }
}

#[inline(always)]
fn window_sum<S: Simd>(simd: S, at: impl Fn(usize) -> F<S>) -> F<S> {
    let mut sum = at(RADIUS) * GAUSSIAN[RADIUS];
    for (n, &weight) in GAUSSIAN[..RADIUS].iter().enumerate() {
        sum = (at(n) + at(2 * RADIUS - n)).mul_add(splat(simd, weight), sum);
    }
    sum
}

#[inline(always)]
fn blur_line<S: Simd>(simd: S, line: &[f32], out: &mut [f32]) {
    for (n, out) in out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let window = &line[n * LANES..n * LANES + LANES + 2 * RADIUS];
        let sum = window_sum(
            simd,
            #[inline(always)]
            |n| f32x16::from_slice(simd, &window[n..n + LANES]),
        );
        sum.store_slice(out);
    }
}
