//! The backward pass of blending: nine sums for every intersection.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::prelude::*;
use rayon::prelude::*;

use super::brush::{Brush, TRANSMITTANCE_STOP, first_transmittance, is_held};
use super::{Batches, Canvas, Tile};
use crate::View;
use crate::bins::{Bins, Entry, TILE};
use crate::project::{Projection, Splat};
use crate::simd::{F, LANES, Lanes, each, load, load_some, splat, vectorised};

/// Numbers of an intersection.
pub const SUMS: usize = 9;

/// Sums over the pixels of every intersection, by slot, with v the derivative of the loss by the
/// exponent sigma: gradient by red, green and blue, then sums of v, v dx, v dy, v dx^2, v dx dy,
/// v dy^2. The gradients of a projected Gaussian follow from them with its conic and opacity.
#[derive(Debug, Default)]
pub struct SlotSums {
    rows: Vec<[AtomicU32; SUMS]>,
}

/// The pixels of a tile by row: transmittance (negative once stopped), derivative by the colour,
/// and that derivative times the colour still behind.
struct Upstream {
    transmittance: [Lanes; TILE[1]],
    colour: [[Lanes; 3]; TILE[1]],
    behind: [Lanes; TILE[1]],
}

impl SlotSums {
    /// Walks the lists of the last [`Canvas::run`] again. `gradient`: derivative of the loss by the
    /// image, planar [3, height, width].
    pub fn run(
        &mut self,
        projection: &Projection,
        bins: &Bins,
        canvas: &Canvas,
        gradient: &[f32],
        view: &View,
    ) {
        let slots = bins.intersections();
        if self.rows.len() < slots {
            self.rows.resize_with(slots + slots / 4, Default::default);
        }
        let rows = &self.rows;
        let tiles_x = bins.tiles()[0];
        (0..bins.len()).into_par_iter().for_each(|index| {
            let tile = Tile::new(index % tiles_x, index / tiles_x, view.size);
            let last = canvas.last[index] as usize;
            let mut entries = bins.entries(index);
            let blended = entries.by_ref().take(last);
            let image = (&canvas.image[..], gradient, view.size);
            vectorised!(simd => {
                let mut pixels = Upstream::new(simd, image, tile);
                backward(simd, tile, blended, &projection.splats, rows, &mut pixels);
            });
            // Splats behind the last visible one have no effect.
            for entry in entries {
                rows[entry.slot].iter().for_each(|sum| sum.store(0, Relaxed));
            }
        });
    }

    /// The sums of a slot.
    pub fn row(&self, slot: usize) -> [f32; SUMS] {
        std::array::from_fn(|n| f32::from_bits(self.rows[slot][n].load(Relaxed)))
    }
}

impl Upstream {
    /// From the image, the gradient by it, and their size in px.
    #[inline(always)]
    fn new<S: Simd>(
        simd: S,
        (image, gradient, size): (&[f32], &[f32], [usize; 2]),
        tile: Tile,
    ) -> Self {
        let mut out = Self {
            transmittance: [[0.0; LANES]; TILE[1]],
            colour: [[[0.0; LANES]; 3]; TILE[1]],
            behind: [[0.0; LANES]; TILE[1]],
        };
        let plane = size[0] * size[1];
        for row in 0..tile.size[1] {
            let begin = (tile.at[1] + row) * size[0] + tile.at[0];
            let mut behind = splat(simd, 0.0);
            for channel in 0..3 {
                let first = channel * plane + begin;
                let by = load_some(simd, &gradient[first..first + tile.size[0]]);
                let value = load_some(simd, &image[first..first + tile.size[0]]);
                behind = by.mul_add(value, behind);
                by.store_slice(&mut out.colour[row][channel]);
            }
            behind.store_slice(&mut out.behind[row]);
        }
        out
    }
}

/// Sums over the rows, a lane each; those that take dx are multiplied by it at the end.
struct Sums<S: Simd> {
    colour: [F<S>; 3],
    v: F<S>,
    v_dy: F<S>,
    v_dy2: F<S>,
}

#[inline(always)]
fn backward<S: Simd>(
    simd: S,
    tile: Tile,
    entries: impl Iterator<Item = Entry>,
    splats: &[Splat],
    rows: &[[AtomicU32; SUMS]],
    pixels: &mut Upstream,
) {
    first_transmittance(simd, tile, &mut pixels.transmittance);
    let mut batches = Batches::new(entries);
    while batches.next(splats).is_some() {
        for (slot, splat_row) in batches.get() {
            let brush = Brush::new(simd, splat_row, tile);
            let colour = each!([0, 1, 2] n => splat(simd, brush.colour[n]));
            let zero = splat(simd, 0.0);
            let mut sums = Sums { colour: [zero; 3], v: zero, v_dy: zero, v_dy2: zero };
            for row in brush.rows.clone() {
                backward_row(simd, &brush, colour, row, pixels, &mut sums);
            }
            store(&sums, brush.dx, &rows[slot]);
        }
    }
}

#[inline(always)]
fn backward_row<S: Simd>(
    simd: S,
    brush: &Brush<S>,
    colour: [F<S>; 3],
    row: usize,
    pixels: &mut Upstream,
    sums: &mut Sums<S>,
) {
    let raw = brush.raw(simd, row);
    let alpha = brush.alpha(raw);
    let before = load(simd, &pixels.transmittance[row]);
    let after = alpha.mul_add(-before, before);
    let stops = after.simd_lt(TRANSMITTANCE_STOP);
    let zero = splat(simd, 0.0);
    let weight = stops.select(zero, alpha * before);
    let [red, green, blue] = each!([0, 1, 2] n => load(simd, &pixels.colour[row][n]));
    let along = blue.mul_add(colour[2], green.mul_add(colour[1], red * colour[0]));
    let rest = weight.mul_add(-along, load(simd, &pixels.behind[row]));
    let by_alpha = before.mul_add(along, -(rest / (splat(simd, 1.0) - alpha)));
    let v = (stops | is_held(raw)).select(zero, by_alpha * -alpha);
    rest.store_slice(&mut pixels.behind[row]);
    stops.select(-before.abs(), after).store_slice(&mut pixels.transmittance[row]);
    sums.colour[0] = weight.mul_add(red, sums.colour[0]);
    sums.colour[1] = weight.mul_add(green, sums.colour[1]);
    sums.colour[2] = weight.mul_add(blue, sums.colour[2]);
    let dy = splat(simd, brush.dy(row));
    let v_dy = v * dy;
    sums.v += v;
    sums.v_dy += v_dy;
    sums.v_dy2 = v_dy.mul_add(dy, sums.v_dy2);
}

/// Adds the lanes up, always in the same order.
#[inline(always)]
fn store<S: Simd>(sums: &Sums<S>, dx: F<S>, row: &[AtomicU32; SUMS]) {
    let [red, green, blue] = sums.colour;
    let v_dx = sums.v * dx;
    let all = [red, green, blue, sums.v, v_dx, sums.v_dy, v_dx * dx, sums.v_dy * dx, sums.v_dy2];
    let mut fours = [[0.0; 4]; SUMS];
    for (four, lanes) in fours.iter_mut().zip(&all) {
        let (low, high) = lanes.split();
        let (low, high) = (low + high).split();
        (low + high).store_slice(four);
    }
    for ([a, b, c, d], sum) in fours.into_iter().zip(row) {
        sum.store(((a + c) + (b + d)).to_bits(), Relaxed);
    }
}
