//! Differential evolution (Storn and Price 1997) in a small box, as in the paper.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

/// Dimensions of the search.
const DIMENSIONS: usize = 2;

/// A point of the unit square.
type Point = [f64; DIMENSIONS];

/// Parameters of the search.
pub(super) struct Evolution {
    /// Number of individuals.
    population: usize,
    /// Most generations after the initial one.
    generations: u32,
    /// The search ends when the costs' standard deviation is at most this share of their mean.
    tolerance: f64,
    /// Probability that a parameter comes from the mutant.
    crossover: f64,
}

/// The best point found.
pub(super) struct Best {
    pub(super) point: Point,
    pub(super) cost: f64,
    pub(super) generations: u32,
}

impl Evolution {
    /// The parameters of the paper's curves: a population of 10 per parameter, as SciPy counts it.
    /// The tolerance is relative, strategy and crossover are SciPy's defaults.
    ///
    /// The paper does not say: whose differential evolution it uses. SciPy's also updates its
    /// population in place, which no two threads can, and polishes the best point by L-BFGS-B.
    /// population in place, which no two threads can, and polishes the best point by L-BFGS-B.
    pub(super) const PAPER: Self =
        Self { population: 10 * DIMENSIONS, generations: 30, tolerance: 1e-4, crossover: 0.7 };

    /// The parameters for exposures: 10 in total find the two numbers of so smooth a function.
    pub(super) const EXPOSURE: Self = Self { population: 10, ..Self::PAPER };

    /// Minimises `cost` over the unit square with strategy best1bin, F drawn from 0.5..1 for each
    /// generation, from a Latin hypercube. Each generation's costs are computed in parallel from
    /// the previous one, so the outcome depends on the seed alone. A NaN cost loses.
    pub(super) fn minimise(&self, seed: u64, cost: impl Fn(Point) -> f64 + Sync) -> Best {
        let mut rng = Pcg64::seed_from_u64(seed);
        let safe =
            |point: &Point| Some(cost(*point)).filter(|c| !c.is_nan()).unwrap_or(f64::INFINITY);
        let mut points = self.latin_hypercube(&mut rng);
        let mut costs: Vec<f64> = points.par_iter().map(safe).collect();
        let mut generation = 0;
        while generation < self.generations && !self.settled(&costs) {
            let trials = self.trials(&points, best_of(&costs), &mut rng);
            let trial_costs: Vec<f64> = trials.par_iter().map(safe).collect();
            for (i, (trial, cost)) in trials.into_iter().zip(trial_costs).enumerate() {
                if cost <= costs[i] {
                    (points[i], costs[i]) = (trial, cost);
                }
            }
            generation += 1;
        }
        let best = best_of(&costs);
        Best { point: points[best], cost: costs[best], generations: generation }
    }

    /// One point in each row and column of a population x population grid.
    fn latin_hypercube(&self, rng: &mut Pcg64) -> Vec<Point> {
        let n = self.population;
        let axes: [Vec<f64>; DIMENSIONS] = std::array::from_fn(|_| {
            let mut axis: Vec<f64> =
                (0..n).map(|i| (i as f64 + rng.random::<f64>()) / n as f64).collect();
            (1..n).rev().for_each(|i| axis.swap(i, rng.random_range(0..=i)));
            axis
        });
        (0..n).map(|i| std::array::from_fn(|d| axes[d][i])).collect()
    }

    /// One challenger per individual.
    fn trials(&self, points: &[Point], best: usize, rng: &mut Pcg64) -> Vec<Point> {
        let factor = rng.random_range(0.5..1.0);
        (0..points.len())
            .map(|i| {
                let (a, b) = two_others(points.len(), i, rng);
                let forced = rng.random_range(0..DIMENSIONS);
                std::array::from_fn(|d| {
                    let mutate = d == forced || rng.random::<f64>() < self.crossover;
                    let mutant = points[best][d] + factor * (points[a][d] - points[b][d]);
                    // Outside the box a fresh value is drawn: clamping would accumulate points at
                    // the edge.
                    let inside = if (0.0..=1.0).contains(&mutant) { mutant } else { rng.random() };
                    if mutate { inside } else { points[i][d] }
                })
            })
            .collect()
    }

    fn settled(&self, costs: &[f64]) -> bool {
        let n = costs.len() as f64;
        let mean = costs.iter().sum::<f64>() / n;
        let variance = costs.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / n;
        variance.sqrt() <= self.tolerance * mean.abs()
    }
}

fn best_of(costs: &[f64]) -> usize {
    (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b])).expect("a population")
}

/// Two different individuals, neither of them `own`.
fn two_others(count: usize, own: usize, rng: &mut Pcg64) -> (usize, usize) {
    let mut draw = |taken: &[usize]| loop {
        let index = rng.random_range(0..count);
        if !taken.contains(&index) {
            return index;
        }
    };
    let first = draw(&[own]);
    (first, draw(&[own, first]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn valley(point: Point) -> f64 {
        let (x, y) = (4.0 * point[0] - 2.0, 4.0 * point[1] - 2.0);
        (1.0 - x).powi(2) + 100.0 * (y - x * x).powi(2)
    }

    #[test]
    fn the_minimum_of_a_bowl_is_found() {
        let best =
            Evolution::PAPER.minimise(1, |p| 1.0 + (p[0] - 0.3).powi(2) + (p[1] - 0.85).powi(2));
        assert!(
            (best.point[0] - 0.3).abs() < 0.02 && (best.point[1] - 0.85).abs() < 0.02,
            "{:?}",
            best.point
        );
    }

    #[test]
    fn a_curved_valley_is_descended_and_seeds_are_repeatable() {
        let long = Evolution { generations: 300, tolerance: 0.0, ..Evolution::EXPOSURE };
        let best = long.minimise(3, valley);
        assert!(best.cost < 1e-6, "{}", best.cost);
        assert_eq!(best.point, long.minimise(3, valley).point);
        assert_ne!(best.point, long.minimise(4, valley).point);
    }

    #[test]
    fn the_start_has_one_point_in_every_row_and_column() {
        let points = Evolution::PAPER.latin_hypercube(&mut Pcg64::seed_from_u64(5));
        assert_eq!(points.len(), 20, "10 for each of two parameters");
        for d in 0..DIMENSIONS {
            let mut cells: Vec<usize> = points.iter().map(|p| (p[d] * 20.0) as usize).collect();
            cells.sort_unstable();
            assert_eq!(cells, (0..20).collect::<Vec<_>>());
        }
    }

    #[test]
    fn nan_costs_neither_win_nor_stop_the_search() {
        let best = Evolution::PAPER.minimise(2, |p| if p[0] < 0.5 { f64::NAN } else { 1.0 + p[0] });
        assert!(best.point[0] >= 0.5 && best.cost < 1.6);
    }
}
