//! Densification as MCMC: Gaussians without opacity move onto others, and the scene grows to its
//! cap. Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo", 2024, equation 9.

pub mod classic;

use rand::{Rng, RngExt};
use rayon::prelude::*;

use crate::splat::rows::GeometryRow;

/// Greatest opacity of a dead Gaussian.
pub const MIN_OPACITY: f32 = 0.005;
/// Most copies into which a Gaussian is split.
pub const MOST_COPIES: u32 = 51;
/// Squared norm below which a quaternion has no direction.
const SMALLEST_QUAT: f32 = 1e-8;
/// Least factor of growth at a densification.
pub const GROWTH: f64 = 1.05;

/// The changes of a densification.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// Target and source; a source also appears as its own target.
    pub moves: Vec<[u32; 2]>,
    /// Log-scale x y z and opacity logit of the target, by move.
    pub shapes: Vec<[f32; 4]>,
    /// Number of Gaussians afterwards.
    pub count: usize,
    /// Dead Gaussians that were moved.
    pub relocated: usize,
}

fn usable(row: &GeometryRow) -> bool {
    let numbers = row.mean.iter().chain(&row.log_scale).chain(&row.quat);
    let finite = numbers.chain([&row.opacity_logit]).all(|v| v.is_finite());
    finite && row.quat.iter().map(|v| v * v).sum::<f32>() >= SMALLEST_QUAT
}

fn opacity(row: &GeometryRow) -> f32 {
    if usable(row) { 1.0 / (1.0 + (-row.opacity_logit).exp()) } else { 0.0 }
}

/// Plans a densification of `rows`: every dead Gaussian moves, and the scene grows to `target`
/// rows. Sources are drawn in proportion to opacity.
pub fn plan(rows: &[GeometryRow], target: usize, random: &mut impl Rng) -> Plan {
    let opacities: Vec<_> = rows.par_iter().map(opacity).collect();
    let dead: Vec<_> = (0..rows.len()).filter(|&i| opacities[i] <= MIN_OPACITY).collect();
    let grown = target.max(rows.len());
    let targets: Vec<_> = dead.iter().copied().chain(rows.len()..grown).collect();
    let mut cumulative = Vec::with_capacity(rows.len());
    let mut total = 0.0_f64;
    for &opacity in &opacities {
        total += if opacity > MIN_OPACITY { f64::from(opacity) } else { 0.0 };
        cumulative.push(total);
    }
    if total <= 0.0 {
        return Plan { count: rows.len(), ..Plan::default() };
    }
    let mut copies = vec![1_u32; rows.len()];
    let mut moves = Vec::with_capacity(2 * targets.len());
    for &to in &targets {
        let source = draw(&cumulative, total, &copies, random);
        copies[source] += 1;
        moves.push([to as u32, source as u32]);
    }
    moves.extend((0..rows.len()).filter(|&i| copies[i] > 1).map(|i| [i as u32; 2]));
    let shape = |source: u32| split(&rows[source as usize], copies[source as usize]);
    let shapes = moves.iter().map(|&[_, source]| shape(source)).collect();
    Plan { moves, shapes, count: grown, relocated: dead.len() }
}

/// Draws an index in proportion to opacity, among those that may still be split.
fn draw(cumulative: &[f64], total: f64, copies: &[u32], random: &mut impl Rng) -> usize {
    for _ in 0..64 {
        let at = random.random::<f64>() * total;
        let index = cumulative.partition_point(|&sum| sum <= at).min(cumulative.len() - 1);
        if copies[index] < MOST_COPIES {
            return index;
        }
    }
    // Nearly everything is dead: take the living one with the fewest splits.
    let alive = |i: &usize| cumulative[*i] > if *i == 0 { 0.0 } else { cumulative[*i - 1] };
    (0..copies.len()).filter(alive).min_by_key(|&i| copies[i]).unwrap_or(0)
}

/// Log-scales and logit of each of `copies` equal Gaussians that together look like `row`.
fn split(row: &GeometryRow, copies: u32) -> [f32; 4] {
    let old = f64::from(opacity(row));
    let new =
        (1.0 - (1.0 - old).powf(1.0 / f64::from(copies))).clamp(f64::from(MIN_OPACITY), 1.0 - 1e-6);
    let mut denominator = 0.0;
    for i in 1..=copies {
        let mut binomial = 1.0;
        for k in 0..i {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            denominator += binomial * sign * new.powi(k as i32 + 1) / f64::from(k + 1).sqrt();
            binomial *= f64::from(i - 1 - k) / f64::from(k + 1);
        }
    }
    let shift = (old / denominator).ln();
    // The alternating sum loses all its digits for many opaque copies; a split never enlarges a
    // splat.
    let shift = if shift.is_finite() { shift.clamp(-3.0, 0.0) } else { 0.0 };
    let scale = |axis: usize| (f64::from(row.log_scale[axis]) + shift) as f32;
    [scale(0), scale(1), scale(2), (new / (1.0 - new)).ln() as f32]
}

/// Number of Gaussians after the next growth. Long rounds grow by [`GROWTH`] each time; short ones
/// have few densifications, so a larger factor reaches the cap after half of them.
pub fn grown(count: usize, start: usize, cap: usize, densifications: u32) -> usize {
    let half = f64::from(densifications.max(2)) / 2.0;
    let needed = (cap as f64 / start.max(1) as f64).powf(1.0 / half);
    ((count as f64 * needed.max(GROWTH)) as usize).min(cap.max(count))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    fn row(opacity: f32) -> GeometryRow {
        let logit = (opacity / (1.0 - opacity)).ln();
        GeometryRow {
            mean: [0.1, 0.2, 0.3],
            log_scale: [-2.0, -1.0, -3.0],
            quat: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: logit,
            spare: 0.0,
        }
    }

    #[test]
    fn dead_gaussians_move_and_the_scene_grows_to_its_target() {
        let mut rows: Vec<_> = (0..40).map(|_| row(0.6)).collect();
        rows[3] = row(0.001);
        rows[5].mean[0] = f32::NAN;
        let plan = plan(&rows, 44, &mut Pcg64::seed_from_u64(1));
        let targets: Vec<_> =
            plan.moves.iter().filter(|[to, from]| to != from).map(|[to, _]| *to).collect();
        assert_eq!(targets, [3, 5, 40, 41, 42, 43]);
        assert_eq!((plan.count, plan.relocated), (44, 2));
        for [to, source] in &plan.moves {
            assert!(*source != 3 && *source != 5 && *source < 40);
            assert!(
                to == source || plan.moves.contains(&[*source, *source]),
                "the source changes too"
            );
        }
    }

    #[test]
    fn without_living_gaussians_nothing_happens() {
        let plan = plan(&[row(0.001); 5], 9, &mut Pcg64::seed_from_u64(1));
        assert_eq!(plan, Plan { count: 5, ..Plan::default() });
    }

    #[test]
    fn no_gaussian_is_split_beyond_the_limit_while_others_live() {
        let mut rows = vec![row(0.001); 120];
        rows[0] = row(0.9);
        rows[1] = row(0.01);
        rows[2] = row(0.01);
        rows[3] = row(0.01);
        let plan = plan(&rows, 120, &mut Pcg64::seed_from_u64(2));
        let copies = plan.moves.iter().filter(|[_, source]| *source == 0).count() as u32;
        assert!(copies <= MOST_COPIES, "{copies}");
        assert!(plan.shapes.iter().flatten().all(|v| v.is_finite()));
    }

    #[test]
    fn copies_together_keep_opacity_and_projected_mass() {
        for (opacity, copies) in [(0.3, 2), (0.6, 2), (0.6, 5), (0.9, 3)] {
            let [x, _, _, logit] = split(&row(opacity), copies);
            let each = 1.0 / (1.0 + (-f64::from(logit)).exp());
            let centre = 1.0 - (1.0 - each).powi(copies as i32);
            assert!((centre - f64::from(opacity)).abs() < 1e-5);
            // The integral along a line through the centre, which equation 9 preserves.
            let ratio = (f64::from(x) + 2.0).exp();
            let integral = |width: f64, alpha: &dyn Fn(f64) -> f64| {
                (-4_000..4_000).map(|n| alpha(f64::from(n) * 0.002 / width)).sum::<f64>()
            };
            let bell = |d: f64| (-0.5 * d * d).exp();
            let before = integral(1.0, &|d| f64::from(opacity) * bell(d));
            let after = integral(ratio, &|d| 1.0 - (1.0 - each * bell(d)).powi(copies as i32));
            assert!((after / before - 1.0).abs() < 1e-3, "{opacity} {copies}: {after} {before}");
        }
    }

    #[test]
    fn growth_reaches_the_cap_and_never_passes_it() {
        assert_eq!(grown(100, 100, 100, 15), 100);
        assert_eq!(grown(120, 100, 100, 15), 120);
        let mut count = 1_000;
        for _ in 0..8 {
            count = grown(count, 1_000, 10_000, 15);
        }
        assert_eq!(count, 10_000);
        assert_eq!(grown(1_000, 1_000, 1_010, 15), 1_010);
    }
}
