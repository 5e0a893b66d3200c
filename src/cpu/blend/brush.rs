//! Alpha of a splat over the rows of a tile, shared by both passes, so that they take the same
//! decisions.

use std::ops::Range;

use fearless_simd::prelude::*;

use super::Tile;
use crate::bins::{TILE, span, whole};
use crate::project::{ALPHA_CUT, ALPHA_MAX, Splat, entry};
use crate::simd::{F, LANES, Lanes, M, each, exp2, load, ramp, splat};

/// Blending stops before the splat that would reduce the transmittance below this.
pub(super) const TRANSMITTANCE_STOP: f32 = 1e-4;

/// A splat over a tile.
pub(super) struct Brush<S: Simd> {
    /// Pixel centres of a row minus the mean.
    pub(super) dx: F<S>,
    /// The first row's centre minus the mean.
    pub(super) top: f32,
    /// Rows that it may touch.
    pub(super) rows: Range<usize>,
    /// A dx^2 + log2(opacity), and B dx.
    fixed: F<S>,
    cross: F<S>,
    /// C.
    curve: f32,
    most: F<S>,
    pub(super) colour: [f32; 3],
}

impl<S: Simd> Brush<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, row: &Splat, tile: Tile) -> Self {
        let left = tile.at[0] as f32 + 0.5 - row[entry::MEAN];
        let top = tile.at[1] as f32 + 0.5 - row[entry::MEAN + 1];
        let [low, high] = span(row, 1, left, left + (LANES - 1) as f32);
        let [first, last] = whole(low - top, high - top, tile.size[1]);
        let dx = ramp(simd) + left;
        let fixed = (dx * row[entry::CURVE]).mul_add(dx, row[entry::LOG_OPACITY]);
        Self {
            dx,
            top,
            rows: first as usize..(last + 1).max(first) as usize,
            fixed,
            cross: dx * row[entry::CURVE + 1],
            curve: row[entry::CURVE + 2],
            most: splat(simd, row[entry::MOST]),
            colour: each!([0, 1, 2] n => row[entry::COLOUR + n]),
        }
    }

    /// The row's centre minus the mean.
    #[inline(always)]
    pub(super) fn dy(&self, row: usize) -> f32 {
        self.top + row as f32
    }

    /// Opacity times the Gaussian.
    #[inline(always)]
    pub(super) fn raw(&self, simd: S, row: usize) -> F<S> {
        let dy = self.dy(row);
        let fixed = self.fixed + self.curve * dy * dy;
        exp2(self.cross.mul_add(splat(simd, dy), fixed))
    }

    /// Within its bounds; 0 where it has no effect.
    #[inline(always)]
    pub(super) fn alpha(&self, raw: F<S>) -> F<S> {
        raw.simd_ge(ALPHA_CUT).select(raw.min(self.most), splat(raw.witness(), 0.0))
    }
}

/// Whether alpha is clamped and has no derivative.
#[inline(always)]
pub(super) fn is_held<S: Simd>(raw: F<S>) -> M<S> {
    raw.simd_ge(ALPHA_MAX)
}

/// 1 for the pixels of a tile within the image, -1 outside.
#[inline(always)]
pub(super) fn first_transmittance<S: Simd>(
    simd: S,
    tile: Tile,
    transmittance: &mut [Lanes; TILE[1]],
) {
    let inside = ramp(simd).simd_lt(tile.size[0] as f32);
    let first = inside.select(splat(simd, 1.0), splat(simd, -1.0));
    for (row, lanes) in transmittance.iter_mut().enumerate() {
        let here = if row < tile.size[1] { first } else { splat(simd, -1.0) };
        here.store_slice(lanes);
    }
}

/// Whether all pixels have stopped.
#[inline(always)]
pub(super) fn is_done<S: Simd>(simd: S, transmittance: &[Lanes; TILE[1]]) -> bool {
    let mut most = load(simd, &transmittance[0]);
    for row in &transmittance[1..] {
        most = most.max(load(simd, row));
    }
    !most.simd_gt(0.0).any_true()
}
