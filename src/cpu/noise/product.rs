//! Products of matrices of 128 columns.
//!
//! Vectors run along the columns, which are the outputs of a layer. The forward pass and the
//! derivatives by inputs and by weights are then products of rows and broadcast numbers, and no
//! matrix of pixels is transposed. Matrices lie in panels of 32 columns; a panel stays in the first
//! cache while tiles of rows pass by.

use fearless_simd::prelude::*;

use crate::simd::{F, LANES, Lanes, load, splat};

/// Columns of all matrices: outputs of a layer.
pub(super) const WIDTH: usize = 128;
/// Panels of a matrix.
pub(super) const PANELS: usize = 4;
/// Vectors of a panel's row.
const VECTORS: usize = WIDTH / PANELS / LANES;
/// Columns of a panel.
const COLUMNS: usize = WIDTH / PANELS;

/// 32 numbers of a row.
type Cell = [Lanes; VECTORS];
/// A row of 128 numbers.
pub(super) type Row = [Cell; PANELS];
/// A matrix of 128 columns.
pub(super) type Matrix<const ROWS: usize> = [[Cell; ROWS]; PANELS];
/// The weights of a layer: a row an input.
pub(super) type Weights = Matrix<WIDTH>;

/// A row of zeros.
pub(super) const ZERO: Row = [[[0.0; LANES]; VECTORS]; PANELS];

/// The numbers of a row.
#[inline(always)]
pub(super) fn numbers(row: &Row) -> &[f32] {
    row.as_flattened().as_flattened()
}

/// The vectors of a row.
#[inline(always)]
pub(super) fn vectors(row: &Row) -> &[Lanes] {
    row.as_flattened()
}

/// Converts a sum to an element of the product.
#[derive(Clone, Copy)]
pub(super) enum Gate<'a, const ROWS: usize> {
    /// Negative sums become 0.
    Relu,
    /// Sums become 0 where this is not positive.
    By(&'a Matrix<ROWS>),
}

/// Rows times weights.
pub(super) struct Product<'a, const ROWS: usize> {
    pub(super) rows: &'a Matrix<ROWS>,
    pub(super) weights: &'a Weights,
    /// Initial value of each sum.
    pub(super) start: &'a Row,
    pub(super) gate: Gate<'a, ROWS>,
}

/// Whether a vector of sixteen fits one register, as with AVX-512, which has 32 of them.
#[inline(always)]
fn is_wide<S: Simd>() -> bool {
    <S::f32s as SimdBase<S>>::N == LANES
}

impl<const ROWS: usize> Product<'_, ROWS> {
    /// The first `count` rows of the product; further ones up to a multiple of eight get undefined
    /// values. Each sum runs over the columns in order.
    #[inline(always)]
    pub(super) fn run<S: Simd>(&self, simd: S, count: usize, out: &mut Matrix<ROWS>) {
        if is_wide::<S>() {
            self.tiles::<S, 8, 2>(simd, count, out);
        } else {
            self.tiles::<S, 4, 1>(simd, count, out);
        }
    }

    #[inline(always)]
    fn tiles<S: Simd, const M: usize, const N: usize>(
        &self,
        simd: S,
        count: usize,
        out: &mut Matrix<ROWS>,
    ) {
        for (panel, out) in out.iter_mut().enumerate() {
            for first in (0..VECTORS).step_by(N) {
                let tiles = out.as_chunks_mut::<M>().0.iter_mut().enumerate();
                for (tile, out) in tiles.take(count.div_ceil(M)) {
                    let sums = self.tile::<S, M, N>(simd, panel, first, tile);
                    for (m, (sums, out)) in sums.into_iter().zip(out).enumerate() {
                        for (n, sum) in sums.into_iter().enumerate() {
                            let vector = first + n;
                            let value = match self.gate {
                                Gate::Relu => sum.max(0.0),
                                Gate::By(by) => {
                                    let by = load(simd, &by[panel][tile * M + m][vector]);
                                    by.simd_gt(0.0).select(sum, splat(simd, 0.0))
                                }
                            };
                            value.store_slice(&mut out[vector]);
                        }
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const M: usize, const N: usize>(
        &self,
        simd: S,
        panel: usize,
        first: usize,
        tile: usize,
    ) -> [[F<S>; N]; M] {
        let mut start = [splat(simd, 0.0); N];
        for (start, lanes) in start.iter_mut().zip(&self.start[panel][first..]) {
            *start = load(simd, lanes);
        }
        let mut sums = [start; M];
        let weights = self.weights[panel].as_chunks::<COLUMNS>().0;
        for (rows, weights) in self.rows.iter().zip(weights) {
            let rows = &rows.as_chunks::<M>().0[tile];
            for (k, weights) in weights.iter().enumerate() {
                for m in 0..M {
                    let x = splat(simd, rows[m].as_flattened()[k]);
                    for n in 0..N {
                        sums[m][n] = x.mul_add(load(simd, &weights[first + n]), sums[m][n]);
                    }
                }
            }
        }
        sums
    }
}

/// Adds the derivative by a layer's weights over the first `count` rows of its inputs and of the
/// derivative by its outputs. Each sum runs over the rows in order.
#[inline(always)]
pub(super) fn add_by_weights<S: Simd, const ROWS: usize>(
    simd: S,
    inputs: &Matrix<ROWS>,
    delta: &Matrix<ROWS>,
    count: usize,
    out: &mut Weights,
) {
    if is_wide::<S>() {
        add_tiles::<S, 8, 2, ROWS>(simd, inputs, delta, count, out);
    } else {
        add_tiles::<S, 4, 1, ROWS>(simd, inputs, delta, count, out);
    }
}

#[inline(always)]
fn add_tiles<S: Simd, const M: usize, const N: usize, const ROWS: usize>(
    simd: S,
    inputs: &Matrix<ROWS>,
    delta: &Matrix<ROWS>,
    count: usize,
    out: &mut Weights,
) {
    for (delta, out) in delta.iter().zip(out) {
        for first in (0..VECTORS).step_by(N) {
            for (tile, out) in out.as_chunks_mut::<M>().0.iter_mut().enumerate() {
                let (panel, chunk) = (tile * M / COLUMNS, tile % (COLUMNS / M));
                let mut sums = [[splat(simd, 0.0); N]; M];
                for m in 0..M {
                    for n in 0..N {
                        sums[m][n] = load(simd, &out[m][first + n]);
                    }
                }
                for (input, delta) in inputs[panel].iter().zip(delta).take(count) {
                    let input = &input.as_flattened().as_chunks::<M>().0[chunk];
                    for m in 0..M {
                        let x = splat(simd, input[m]);
                        for n in 0..N {
                            sums[m][n] = x.mul_add(load(simd, &delta[first + n]), sums[m][n]);
                        }
                    }
                }
                for m in 0..M {
                    for n in 0..N {
                        sums[m][n].store_slice(&mut out[m][first + n]);
                    }
                }
            }
        }
    }
}

/// Adds row `index` of a matrix to a row.
#[inline(always)]
pub(super) fn add_row<S: Simd, const ROWS: usize>(
    simd: S,
    matrix: &Matrix<ROWS>,
    index: usize,
    out: &mut Row,
) {
    for (panel, out) in matrix.iter().zip(out) {
        for (vector, out) in panel[index].iter().zip(out) {
            (load(simd, out) + load(simd, vector)).store_slice(out);
        }
    }
}
