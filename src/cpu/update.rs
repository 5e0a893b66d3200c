//! From the sums of the intersections to the gradients of every Gaussian, and Adam's update of it,
//! sixteen at a time, equivalent to shaders/train/project_backward_adam.wgsl.

mod adam;
mod gradient;

use fearless_simd::prelude::*;
use rayon::prelude::*;

use crate::View;
use crate::bins::Bins;
use crate::blend::{SUMS, SlotSums};
use crate::population::Population;
use crate::simd::{LANES, Lanes, load, splat, vectorised};
use adam::Numbers;
use gradient::Gradient;

/// The parameters of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// Rates of means, log-scales, quaternions and opacity logits.
    pub rates: [f32; 4],
    /// Rate of the constant harmonic.
    pub rate_sh0: f32,
    /// Rate of the higher harmonics.
    pub rate_sh: f32,
    /// 1 / (1 - beta^t) of the first and of the second moments.
    pub bias: [f32; 2],
    /// Gradient of the opacity regulariser by an opacity.
    pub opacity_weight: f32,
    /// Gradient of the scale regulariser by a scale.
    pub scale_weight: f32,
    /// Scale of the exploration noise on the means; 0 switches it off.
    pub noise: f32,
    /// Seed of that noise.
    pub seed: u32,
    /// 0-based.
    pub step: u32,
    /// Whether the lengths of the gradients by position are summed up, for classic densification.
    pub accumulates: bool,
}

/// Results of blending a view that the update needs.
#[derive(Clone, Copy)]
pub struct Blended<'a> {
    pub view: &'a View,
    pub bins: &'a Bins,
    pub sums: &'a SlotSums,
}

/// Blocks of a task.
const TASK: usize = 16;

/// The sums of sixteen Gaussians, and 1 for those that touch a tile.
struct Seen {
    sums: [Lanes; SUMS],
    touched: Lanes,
}

impl Blended<'_> {
    fn seen(&self, block: usize) -> Seen {
        let mut out = Seen { sums: [[0.0; LANES]; SUMS], touched: [0.0; LANES] };
        for lane in 0..LANES {
            let slots = self.bins.slots(block * LANES + lane);
            if slots.is_empty() {
                continue;
            }
            out.touched[lane] = 1.0;
            let mut sum = [0.0; SUMS];
            for slot in slots {
                sum.iter_mut().zip(self.sums.row(slot)).for_each(|(sum, value)| *sum += value);
            }
            (0..SUMS).for_each(|n| out.sums[n][lane] = sum[n]);
        }
        out
    }

    /// Updates every Gaussian. Returns how many kept their numbers because a gradient was not
    /// finite.
    pub fn update(&self, population: &mut Population, step: &Step) -> usize {
        let blocks = population.len().div_ceil(LANES);
        let columns = population.columns();
        let rows = blocks * columns;
        let values = population.values[..rows].par_chunks_mut(TASK * columns);
        let first = population.first[..rows].par_chunks_mut(TASK * columns);
        let second = population.second[..rows].par_chunks_mut(TASK * columns);
        let seen = population.seen[..blocks].par_chunks_mut(TASK);
        let tasks = values.zip(first).zip(second).zip(seen).enumerate();
        let dropped = tasks.map(|(task, (((values, first), second), seen))| {
            let blocks = values.chunks_exact_mut(columns).zip(first.chunks_exact_mut(columns));
            let blocks = blocks.zip(second.chunks_exact_mut(columns)).zip(seen).enumerate();
            let update = |(n, (((values, first), second), lengths))| {
                let block = task * TASK + n;
                let seen = self.seen(block);
                let mut numbers = Numbers { values, first, second, lengths };
                vectorised!(simd => self.update_block(simd, block, &seen, &mut numbers, step))
            };
            blocks.map(update).sum::<usize>()
        });
        dropped.sum()
    }

    #[inline(always)]
    fn update_block<S: Simd>(
        &self,
        simd: S,
        block: usize,
        seen: &Seen,
        numbers: &mut Numbers<'_>,
        step: &Step,
    ) -> usize {
        let gradient = Gradient::new(simd, numbers.values, seen, self.view);
        let dropped = gradient.shape.usable & !gradient.fits;
        adam::update(simd, block, numbers, &gradient, (self.view, step));
        dropped.to_bitmask().count_ones() as usize
    }

    /// The gradient of every number, [Gaussians, columns], without an update.
    pub fn gradients(&self, population: &Population) -> Vec<f32> {
        let columns = population.columns();
        let mut out = vec![0.0; population.len() * columns];
        let blocks = population.values.chunks_exact(columns).enumerate();
        for (block, numbers) in blocks.take(population.len().div_ceil(LANES)) {
            let seen = self.seen(block);
            let mut lanes = vec![[0.0; LANES]; columns];
            vectorised!(simd => {
                let gradient = Gradient::new(simd, numbers, &seen, self.view);
                for (column, lanes) in lanes.iter_mut().enumerate() {
                    let value = gradient.number(simd, column, self.view.sh_degree);
                    let value = gradient.shape.usable.select(value, splat(simd, 0.0));
                    value.store_slice(lanes);
                }
            });
            for (lane, row) in
                out[block * LANES * columns..].chunks_mut(columns).take(LANES).enumerate()
            {
                row.iter_mut().zip(&lanes).for_each(|(value, lanes)| *value = lanes[lane]);
            }
        }
        out
    }
}

impl Seen {
    #[inline(always)]
    fn sum<S: Simd>(&self, simd: S, n: usize) -> crate::simd::F<S> {
        load(simd, &self.sums[n])
    }
}
