//! Projection of the Gaussians onto the image, sixteen at a time.

pub(crate) mod geometry;
pub(crate) mod harmonics;

use fearless_simd::prelude::*;
use rayon::prelude::*;

use crate::View;
use crate::population::{Population, column};
use crate::simd::{F, LANES, Lanes, M, each, is_finite, ln, log2, splat, vectorised};
use crate::vector::length;
use geometry::{Flat, Shape};

/// Least alpha that is blended.
pub const ALPHA_CUT: f32 = 1.0 / 255.0;
/// Greatest alpha.
pub const ALPHA_MAX: f32 = 0.99;

/// A splat on the image, as a row of sixteen numbers: one line of the cache.
pub type Splat = [f32; LANES];

/// The numbers of a [`Splat`].
pub mod entry {
    /// Mean x and y, px.
    pub const MEAN: usize = 0;
    /// Factors of dx^2, dx dy and dy^2 in the logarithm of alpha to base 2.
    pub const CURVE: usize = 2;
    /// Logarithm of the opacity to base 2.
    pub const LOG_OPACITY: usize = 5;
    /// Greatest alpha: a needle's exponent may round to beyond its peak.
    pub const MOST: usize = 6;
    /// Red, green, blue, at least 0.
    pub const COLOUR: usize = 7;
    /// Half the box of the ellipse in which alpha counts, px.
    pub const EXTENT: usize = 10;
    /// Half its width and height through its centre, px.
    pub const HALF: usize = 12;
    /// How far the middle of a row moves with y, and that of a column with x.
    pub const SHEAR: usize = 14;
}

/// The projections of all Gaussians.
#[derive(Clone, Debug, Default)]
pub struct Projection {
    /// By Gaussian; stale where the depth is infinite.
    pub splats: Vec<Splat>,
    /// z in the camera, world units; infinite if culled. By Gaussian.
    pub depths: Vec<f32>,
}

/// Blocks of a task.
const TASK: usize = 32;

impl Projection {
    /// Projects every Gaussian.
    pub fn run(&mut self, population: &Population, view: &View) {
        let blocks = population.len().div_ceil(LANES);
        self.splats.resize(blocks * LANES, [0.0; LANES]);
        self.depths.resize(blocks * LANES, f32::INFINITY);
        let columns = population.columns();
        let values = population.values[..blocks * columns].par_chunks(TASK * columns);
        let splats = self.splats.par_chunks_mut(TASK * LANES);
        let depths = self.depths.par_chunks_mut(TASK * LANES);
        values.zip(splats).zip(depths).for_each(|((values, splats), depths)| {
            let (splats, depths) = (splats.as_chunks_mut().0, depths.as_chunks_mut().0);
            vectorised!(simd => project_blocks(simd, values, splats, depths, view));
        });
    }
}

#[inline(always)]
fn project_blocks<S: Simd>(
    simd: S,
    values: &[Lanes],
    splats: &mut [[Splat; LANES]],
    depths: &mut [Lanes],
    view: &View,
) {
    let columns = values.len() / depths.len();
    let blocks = values.chunks_exact(columns).zip(splats).zip(depths);
    for ((numbers, splats), depths) in blocks {
        project_block(simd, numbers, splats, depths, view);
    }
}

/// The unit direction from the camera, and the distance.
#[inline(always)]
pub(crate) fn direction<S: Simd>(mean: [F<S>; 3], view: &View) -> ([F<S>; 3], F<S>) {
    let offset = each!([0, 1, 2] n => mean[n] - view.position[n]);
    let distance = length(offset).max(1e-12);
    (each!([0, 1, 2] n => offset[n] / distance), distance)
}

#[inline(always)]
fn project_block<S: Simd>(
    simd: S,
    numbers: &[Lanes],
    splats: &mut [Splat; LANES],
    depths: &mut Lanes,
    view: &View,
) {
    let shape = Shape::new(simd, numbers);
    let flat = Flat::new(simd, &shape, view);
    let (towards, _) = direction(shape.mean, view);
    let basis = harmonics::basis(simd, towards, view.sh_degree);
    let colour = harmonics::colour(simd, &numbers[column::HARMONICS..], &basis, view.sh_degree);
    let mean = each!([0, 1] n => {
        (flat.point[n] * flat.inverse_depth).mul_add(view.focal[n], splat(simd, view.centre[n]))
    });
    // The exponent at which alpha falls to the cut, with room for rounding: spans only save work.
    let limit = ln(shape.opacity.max(1e-12) * 255.0);
    let reach = limit.mul_add(2.000_2, splat(simd, 2e-3)).max(0.0);
    let [a, b, c] = flat.conic;
    let extent = [(reach * flat.flat[0]).sqrt(), (reach * flat.flat[2]).sqrt()];
    let mut seen: M<S> = flat.usable & limit.simd_ge(0.0);
    for (colour, conic) in colour.iter().zip(&flat.conic) {
        seen = seen & is_finite(*colour) & is_finite(*conic);
    }
    for n in 0..2 {
        let (low, high) = (mean[n] - extent[n], mean[n] + extent[n]);
        seen = seen & high.simd_gt(0.0) & low.simd_lt(view.size[n] as f32);
    }
    let infinite = splat(simd, f32::INFINITY);
    seen.select(flat.point[2], infinite).store_slice(depths);
    const HALF_LOG: f32 = -0.5 * std::f32::consts::LOG2_E;
    let columns = [
        mean[0],
        mean[1],
        a * HALF_LOG,
        b * (2.0 * HALF_LOG),
        c * HALF_LOG,
        log2(shape.opacity.max(1e-12)),
        shape.opacity.min(ALPHA_MAX),
        colour[0].max(0.0),
        colour[1].max(0.0),
        colour[2].max(0.0),
        extent[0],
        extent[1],
        (reach / a).sqrt(),
        (reach / c).sqrt(),
        -b / a,
        -b / c,
    ];
    transpose(&columns, splats);
}

/// Lanes of sixteen numbers to sixteen numbers of each lane.
#[inline(always)]
fn transpose<S: Simd>(columns: &[F<S>; LANES], rows: &mut [Splat; LANES]) {
    for (n, column) in columns.iter().enumerate() {
        let lanes = column.as_slice();
        for (row, value) in rows.iter_mut().zip(lanes) {
            row[n] = *value;
        }
    }
}
