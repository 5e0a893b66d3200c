//! Blending of the splats of every tile, front to back, and its backward pass.

mod backward;
mod brush;

use fearless_simd::prelude::*;
use rayon::prelude::*;

use crate::View;
use crate::bins::{Bins, Entry, TILE};
use crate::project::{Projection, Splat};
use crate::simd::{F, LANES, Lanes, each, load, splat, store_some, vectorised};
pub use backward::{SUMS, SlotSums};
use brush::{Brush, TRANSMITTANCE_STOP, first_transmittance, is_done};

/// Splats of a batch. Between two batches a tile checks whether all pixels have stopped.
const BATCH: usize = 8;

/// A rendered image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Canvas {
    /// Planar RGB, [3, height, width].
    pub image: Vec<f32>,
    /// Remaining share of the background, [height, width].
    pub transmittance: Vec<f32>,
    /// Entries of each tile after which all of its pixels have stopped.
    last: Vec<u32>,
}

/// First pixel of a tile, and its pixels within the image.
#[derive(Clone, Copy)]
struct Tile {
    at: [usize; 2],
    size: [usize; 2],
}

impl Tile {
    fn new(column: usize, row: usize, image: [usize; 2]) -> Self {
        let at = [column * TILE[0], row * TILE[1]];
        Self { at, size: [0, 1].map(|n| TILE[n].min(image[n] - at[n])) }
    }
}

/// The pixels of a tile by row. A negative transmittance marks a pixel that has stopped or lies
/// outside the image; its magnitude stays.
struct Pixels {
    transmittance: [Lanes; TILE[1]],
    colour: [[Lanes; 3]; TILE[1]],
}

impl Canvas {
    /// Blends all splats over the view's background.
    pub fn run(&mut self, projection: &Projection, bins: &Bins, view: &View) {
        let [width, height] = view.size;
        let (plane, tiles_x) = (width * height, bins.tiles()[0]);
        self.image.resize(3 * plane, 0.0);
        self.transmittance.resize(plane, 0.0);
        self.last.resize(bins.len(), 0);
        let band = (TILE[1] * width).max(1);
        let (red, rest) = self.image.split_at_mut(plane);
        let (green, blue) = rest.split_at_mut(plane);
        let colours = red.par_chunks_mut(band).zip(green.par_chunks_mut(band));
        let colours = colours.zip(blue.par_chunks_mut(band));
        let rest = self.transmittance.par_chunks_mut(band);
        let rest = rest.zip(self.last.par_chunks_mut(tiles_x.max(1)));
        colours.zip(rest).enumerate().for_each(|(row, (((red, green), blue), rest))| {
            let (transmittance, last) = rest;
            let mut planes = [red, green, blue, transmittance];
            for (column, last) in last.iter_mut().enumerate() {
                let tile = Tile::new(column, row, view.size);
                let entries = bins.entries(row * tiles_x + column);
                let splats = &projection.splats[..];
                vectorised!(simd => {
                    let mut pixels = Pixels::new();
                    *last = blend(simd, tile, entries, splats, &mut pixels);
                    pixels.write(simd, &mut planes, tile, view);
                });
            }
        });
    }
}

impl Pixels {
    #[inline(always)]
    fn new() -> Self {
        Self { transmittance: [[0.0; LANES]; TILE[1]], colour: [[[0.0; LANES]; 3]; TILE[1]] }
    }

    #[inline(always)]
    fn write<S: Simd>(&self, simd: S, planes: &mut [&mut [f32]; 4], tile: Tile, view: &View) {
        for row in 0..tile.size[1] {
            let begin = row * view.size[0] + tile.at[0];
            let left = load(simd, &self.transmittance[row]).abs();
            let [red, green, blue, transmittance] = &mut *planes;
            let range = begin..begin + tile.size[0];
            let channels = [red, green, blue].into_iter().zip(&self.colour[row]);
            for ((plane, lanes), background) in channels.zip(view.background) {
                let colour = left.mul_add(background, load(simd, lanes));
                store_some(colour, &mut plane[range.clone()]);
            }
            store_some(left, &mut transmittance[range]);
        }
    }
}

/// Blends the entries of a tile; returns the number of entries after which all pixels had stopped.
#[inline(always)]
fn blend<S: Simd>(
    simd: S,
    tile: Tile,
    entries: impl ExactSizeIterator<Item = Entry>,
    splats: &[Splat],
    pixels: &mut Pixels,
) -> u32 {
    first_transmittance(simd, tile, &mut pixels.transmittance);
    let count = entries.len();
    let mut batches = Batches::new(entries);
    while let Some(done) = batches.next(splats) {
        if is_done(simd, &pixels.transmittance) {
            return done as u32;
        }
        for (_, splat_row) in batches.get() {
            let brush = Brush::new(simd, splat_row, tile);
            let colour = each!([0, 1, 2] n => splat(simd, brush.colour[n]));
            for row in brush.rows.clone() {
                blend_row(simd, &brush, colour, row, pixels);
            }
        }
    }
    count as u32
}

/// A tile's splats, a few at a time, copied together: the processor then waits for the memory of
/// all of them at once.
struct Batches<I> {
    entries: I,
    slots: [usize; BATCH],
    splats: [Splat; BATCH],
    taken: usize,
    count: usize,
}

impl<I: Iterator<Item = Entry>> Batches<I> {
    #[inline(always)]
    fn new(entries: I) -> Self {
        Self { entries, slots: [0; BATCH], splats: [[0.0; LANES]; BATCH], taken: 0, count: 0 }
    }

    /// Takes the next splats. Returns the number of those before them.
    #[inline(always)]
    fn next(&mut self, splats: &[Splat]) -> Option<usize> {
        self.taken += self.count;
        self.count = 0;
        while self.count < BATCH {
            let Some(entry) = self.entries.next() else { break };
            self.slots[self.count] = entry.slot;
            self.splats[self.count] = splats[entry.gaussian];
            self.count += 1;
        }
        (self.count > 0).then_some(self.taken)
    }

    /// The splats taken last, with their slots.
    #[inline(always)]
    fn get(&self) -> impl Iterator<Item = (usize, &Splat)> {
        self.slots.iter().copied().zip(&self.splats).take(self.count)
    }
}

#[inline(always)]
fn blend_row<S: Simd>(
    simd: S,
    brush: &Brush<S>,
    colour: [F<S>; 3],
    row: usize,
    pixels: &mut Pixels,
) {
    let alpha = brush.alpha(brush.raw(simd, row));
    let before = load(simd, &pixels.transmittance[row]);
    let after = alpha.mul_add(-before, before);
    let stops = after.simd_lt(TRANSMITTANCE_STOP);
    let weight = stops.select(splat(simd, 0.0), alpha * before);
    for (sum, colour) in pixels.colour[row].iter_mut().zip(&colour) {
        weight.mul_add(*colour, load(simd, sum)).store_slice(sum);
    }
    stops.select(-before.abs(), after).store_slice(&mut pixels.transmittance[row]);
}
