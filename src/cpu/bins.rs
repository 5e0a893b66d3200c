//! Which splats each tile blends, near to far: depths are sorted once, tiles are counted.
//!
//! Each task writes to its own places in shared arrays of relaxed atomics, which on x86-64 are
//! plain loads and stores.

mod radix;

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

use crate::project::{Projection, Splat, entry};
use crate::simd::{LANES, vectorised};

/// Width and height of a tile, px. The width is a vector; the state of a tile's pixels in the
/// backward pass, five numbers each, takes 10 KB of the first cache. Half the height takes 10 %
/// longer (560 x 320 px, 30,000 Gaussians).
pub const TILE: [usize; 2] = [LANES, 32];

/// Parts of the order that are counted and filled separately.
const PARTS: usize = 16;

/// Splats that are copied together.
const BATCH: usize = 16;

/// The lists of all tiles.
#[derive(Debug, Default)]
pub struct Bins {
    tiles: [usize; 2],
    sort: radix::Sort,
    parts: Vec<Part>,
    /// First entry by part and tile.
    cursors: Vec<u32>,
    /// First entry of each tile, and the number of all.
    starts: Vec<u32>,
    entries: Vec<AtomicU64>,
    /// First slot and number of slots by Gaussian.
    slots: Vec<AtomicU64>,
}

/// The tiles of the splats of a part, and their number by splat.
#[derive(Debug, Default)]
struct Part {
    found: Vec<u32>,
    counts: Vec<u32>,
}

/// An intersection of a splat and a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Index of the Gaussian.
    pub gaussian: usize,
    /// Index among the intersections of all Gaussians. A Gaussian's slots are contiguous.
    pub slot: usize,
}

fn pair(high: usize, low: usize) -> u64 {
    (high as u64) << 32 | low as u64
}

fn halves(pair: u64) -> [usize; 2] {
    [(pair >> 32) as usize, pair as u32 as usize]
}

/// First and last whole numbers in a range, at least 0 and below the end; empty if the last is
/// below the first.
#[inline(always)]
pub(crate) fn whole(low: f32, high: f32, end: usize) -> [i32; 2] {
    // Clamped beyond the image on either side, so that the conversion keeps the order.
    let held = |v: f32| v.max(-1.0).min(end as f32);
    [held(low).ceil().max(0.0) as i32, (held(high).floor() as i32).min(end as i32 - 1)]
}

/// The range of one coordinate, relative to the splat's mean, that its ellipse covers while the
/// other lies between `low` and `high`. `axis`: 0 for the range of x.
#[inline(always)]
pub(crate) fn span(splat: &Splat, axis: usize, low: f32, high: f32) -> [f32; 2] {
    let [reach, other] = [splat[entry::EXTENT + axis], splat[entry::EXTENT + 1 - axis]];
    let (half, shear) = (splat[entry::HALF + axis], splat[entry::SHEAR + axis]);
    // The farthest point of the ellipse.
    let farthest = splat[entry::SHEAR + 1 - axis] * reach;
    let at = |place: f32, sign: f32| {
        let part = place / other;
        shear.mul_add(place, sign * half * part.mul_add(-part, 1.0).max(0.0).sqrt())
    };
    let (below, above) = ((-farthest).max(low).min(high), farthest.max(low).min(high));
    let first = if below == -farthest { -reach } else { at(below, -1.0) };
    let last = if above == farthest { reach } else { at(above, 1.0) };
    [first, last]
}

/// Calls `found` with every tile in which the splat may have an effect.
#[inline(always)]
fn touched(splat: &Splat, size: [usize; 2], tiles_x: usize, mut found: impl FnMut(usize)) {
    let (x, y) = (splat[entry::MEAN] - 0.5, splat[entry::MEAN + 1] - 0.5);
    let reach = splat[entry::EXTENT + 1];
    let [first, last] = whole(y - reach, y + reach, size[1]);
    let height = TILE[1] as i32;
    if last < first {
        return;
    }
    for row in first / height..=last / height {
        let top = first.max(row * height) as f32 - y;
        let bottom = last.min(row * height + height - 1) as f32 - y;
        let [left, right] = span(splat, 0, top, bottom);
        let [left, right] = whole(x + left, x + right, size[0]);
        if left <= right {
            let base = row as usize * tiles_x;
            for column in left as usize / TILE[0]..=right as usize / TILE[0] {
                found(base + column);
            }
        }
    }
}

impl Bins {
    /// Sorts the visible splats into the tiles of an image of `size` px.
    pub fn run(&mut self, projection: &Projection, size: [usize; 2]) {
        self.tiles = [size[0].div_ceil(TILE[0]), size[1].div_ceil(TILE[1])];
        self.sort.run(&projection.depths);
        let total = self.count(projection, size);
        if self.entries.len() < total {
            self.entries.resize_with(total + total / 4, AtomicU64::default);
        }
        self.slots.resize_with(projection.splats.len(), AtomicU64::default);
        self.slots.iter_mut().for_each(|slots| *slots.get_mut() = 0);
        self.fill();
    }

    fn part(&self) -> usize {
        self.sort.order().len().div_ceil(PARTS).max(1)
    }

    /// Finds the tiles of every splat, and turns the counts of each part into first places.
    fn count(&mut self, projection: &Projection, size: [usize; 2]) -> usize {
        let (tiles, part) = (self.len(), self.part());
        self.cursors.clear();
        self.cursors.resize(PARTS * tiles, 0);
        self.parts.resize_with(PARTS, Part::default);
        let tiles_x = self.tiles[0];
        let counts = self.cursors.par_chunks_mut(tiles.max(1));
        let parts = counts.zip(&mut self.parts).zip(self.sort.order().par_chunks(part));
        parts.for_each(|((counts, part), order)| {
            part.found.clear();
            part.counts.clear();
            vectorised!(_simd => for order in order.chunks(BATCH) {
                // Copied together: the processor waits for the memory of all of them at once.
                let mut splats = [[0.0; LANES]; BATCH];
                for (splat, &pair) in splats.iter_mut().zip(order) {
                    *splat = projection.splats[halves(pair)[1]];
                }
                for splat in &splats[..order.len()] {
                    let before = part.found.len();
                    touched(splat, size, tiles_x, |tile| {
                        counts[tile] += 1;
                        part.found.push(tile as u32);
                    });
                    part.counts.push((part.found.len() - before) as u32);
                }
            });
        });
        self.starts.clear();
        let mut total = 0;
        for tile in 0..tiles {
            self.starts.push(total);
            for part in 0..PARTS {
                let count = &mut self.cursors[part * tiles + tile];
                total += std::mem::replace(count, total);
            }
        }
        self.starts.push(total);
        total as usize
    }

    fn fill(&mut self) {
        let (tiles, part) = (self.len(), self.part());
        let order = self.sort.order();
        let mut sum = 0;
        // Parts without splats still hold earlier results.
        let first: Vec<usize> = { self.parts.iter().take(order.len().div_ceil(part)) }
            .map(|part| {
                let first = sum;
                sum += part.found.len();
                first
            })
            .collect();
        let (entries, slots) = (&self.entries, &self.slots);
        let parts = self.cursors.par_chunks_mut(tiles.max(1)).zip(&self.parts);
        let parts = parts.zip(order.par_chunks(part)).zip(first);
        parts.for_each(|(((cursors, part), order), mut slot)| {
            let mut found = part.found.iter();
            for (&sorted, &count) in order.iter().zip(&part.counts) {
                let gaussian = halves(sorted)[1];
                slots[gaussian].store(pair(slot, count as usize), Relaxed);
                for &tile in found.by_ref().take(count as usize) {
                    let place = &mut cursors[tile as usize];
                    entries[*place as usize].store(pair(gaussian, slot), Relaxed);
                    *place += 1;
                    slot += 1;
                }
            }
        });
    }

    /// Number of tiles.
    pub fn len(&self) -> usize {
        self.tiles[0] * self.tiles[1]
    }

    /// Whether there is no tile.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Columns and rows of tiles.
    pub fn tiles(&self) -> [usize; 2] {
        self.tiles
    }

    /// Number of visible splats.
    pub fn visible(&self) -> usize {
        self.sort.order().len()
    }

    /// Number of intersections of splats and tiles.
    pub fn intersections(&self) -> usize {
        self.starts.last().map_or(0, |&total| total as usize)
    }

    /// The intersections of a tile, near to far; splats of one depth by index.
    pub fn entries(&self, tile: usize) -> impl ExactSizeIterator<Item = Entry> {
        let range = self.starts[tile] as usize..self.starts[tile + 1] as usize;
        self.entries[range].iter().map(|entry| {
            let [gaussian, slot] = halves(entry.load(Relaxed));
            Entry { gaussian, slot }
        })
    }

    /// The slots of a Gaussian; none if it touches no tile.
    pub fn slots(&self, gaussian: usize) -> std::ops::Range<usize> {
        let [first, count] = halves(self.slots[gaussian].load(Relaxed));
        first..first + count
    }
}
