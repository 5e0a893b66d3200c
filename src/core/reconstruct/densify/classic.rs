//! Densification as first published, for comparison: Gaussians with a large gradient of the loss by
//! their position are cloned if small and split if large; transparent ones are removed. Kerbl et
//! al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023, section 5.
//!
//! Opacities are reset every [`RESET_EVERY`] steps, as published: a shorter round never resets
//! them, because it would end before they recover. The published code's removal of Gaussians that
//! are large on the screen has no effect (its issue 123), so there is none here.
//!
//! Differs from the paper: 3DGS grows without a cap. Buffers are allocated once, and memory ends.

use glam::{Quat, Vec3};
use rand::Rng;

use super::{MIN_OPACITY, opacity};
use crate::random::normal;
use crate::splat::rows::GeometryRow;

/// Mean length of the gradient by the position, in normalised device coordinates, above which a
/// Gaussian is too coarse.
const THRESHOLD: f32 = 2e-4;
/// Largest share of the extent at which Gaussians are cloned; larger ones are split.
const SMALL: f64 = 0.01;
/// Share of the extent above which Gaussians are removed after a reset.
const LARGE: f64 = 0.1;
/// Parts of a split Gaussian.
const PARTS: usize = 2;
/// Divisor of the scales of the parts: 0.8 times [`PARTS`].
const SHRINK: f32 = 1.6;
/// Steps between resets.
pub const RESET_EVERY: u32 = 3_000;
/// Largest opacity after a reset.
const RESET_TO: f32 = 0.01;

/// The gradients of a Gaussian by its position since the last densification.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PositionGradient {
    /// Sum of their lengths, in normalised device coordinates.
    pub lengths: f32,
    /// Number of views that showed it.
    pub views: f32,
}

impl PositionGradient {
    fn mean(self) -> f32 {
        self.lengths / self.views.max(1.0)
    }
}

/// One Gaussian after a densification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Descendant {
    /// Index of the Gaussian whose harmonics it inherits.
    pub source: usize,
    pub row: GeometryRow,
    /// Whether it is new, with empty moments in Adam.
    pub new: bool,
}

/// Plans a densification of `rows` into at most `cap`; the largest gradients come first. If none
/// would survive, everything stays. `after_reset`: whether opacities have been reset, after which
/// Gaussians are removed that are large even once they are split.
pub fn plan(
    rows: &[GeometryRow],
    gradients: &[PositionGradient],
    cap: usize,
    extent: f64,
    after_reset: bool,
    random: &mut impl Rng,
) -> Vec<Descendant> {
    let all = || 0..rows.len();
    let as_it_is = |source: usize| Descendant { source, row: rows[source], new: false };
    let kept: Vec<usize> = all().filter(|&i| opacity(&rows[i]) >= MIN_OPACITY).collect();
    let mean = |i: usize| gradients[i].mean();
    let mut coarse: Vec<usize> = kept.iter().copied().filter(|&i| mean(i) >= THRESHOLD).collect();
    coarse.sort_by(|&a, &b| mean(b).total_cmp(&mean(a)).then(a.cmp(&b)));
    coarse.truncate(cap.saturating_sub(kept.len()));
    let splits = |i: &usize| largest(&rows[*i]) > SMALL * extent;
    let split: std::collections::BTreeSet<usize> = coarse.iter().copied().filter(splits).collect();
    let stays = kept.iter().filter(|i| !split.contains(i));
    let mut after: Vec<Descendant> = stays.map(|&source| as_it_is(source)).collect();
    for &source in &coarse {
        if !split.contains(&source) {
            after.push(Descendant { source, row: rows[source], new: true });
            continue;
        }
        for _ in 0..PARTS {
            after.push(Descendant { source, row: part(&rows[source], random), new: true });
        }
    }
    after.retain(|one| !(after_reset && largest(&one.row) > LARGE * extent));
    if after.is_empty() { all().map(as_it_is).collect() } else { after }
}

/// The longest half axis, world units.
fn largest(row: &GeometryRow) -> f64 {
    let [x, y, z] = row.log_scale;
    f64::from(x.max(y).max(z)).exp()
}

/// A smaller Gaussian at a position drawn from `row`.
fn part(row: &GeometryRow, random: &mut impl Rng) -> GeometryRow {
    let scale = Vec3::from(row.log_scale).exp();
    let drawn = Vec3::from([0; 3].map(|_| normal(random) as f32));
    let [w, x, y, z] = row.quat;
    let rotation = Quat::from_xyzw(x, y, z, w).normalize();
    let offset = rotation * (scale * drawn);
    let mut out = *row;
    for axis in 0..3 {
        out.mean[axis] += offset[axis];
        out.log_scale[axis] -= SHRINK.ln();
    }
    out
}

/// The logit of an opacity after a reset.
pub fn reset(logit: f32) -> f32 {
    logit.min((RESET_TO / (1.0 - RESET_TO)).ln())
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    const LARGE_GRADIENT: PositionGradient = seen_in_ten_views(0.01);

    const fn seen_in_ten_views(lengths: f32) -> PositionGradient {
        PositionGradient { lengths, views: 10.0 }
    }

    /// A Gaussian ten times as long in its own x, which points along the world's y.
    fn row(opacity: f32, scale: f32) -> GeometryRow {
        let (s, logit) = (scale.ln(), (opacity / (1.0 - opacity)).ln());
        // A quarter turn about z; rows need not be normalised.
        GeometryRow {
            mean: [1.0, 2.0, 3.0],
            log_scale: [s + 10.0_f32.ln(), s, s],
            quat: [1.5, 0.0, 0.0, 1.5],
            opacity_logit: logit,
            spare: 0.0,
        }
    }

    fn after(
        rows: &[GeometryRow],
        gradients: &[PositionGradient],
        cap: usize,
        after_reset: bool,
    ) -> Vec<Descendant> {
        plan(rows, gradients, cap, 1.0, after_reset, &mut Pcg64::seed_from_u64(1))
    }

    #[test]
    fn small_ones_are_cloned_large_split_and_transparent_removed() {
        let rows =
            [row(0.6, 1e-4), row(0.6, 0.05), row(0.001, 0.05), row(0.6, 1e-4), row(0.6, 1e-4)];
        // The fourth has half the required gradient; no view showed the last.
        let found = after(
            &rows,
            &[
                LARGE_GRADIENT,
                LARGE_GRADIENT,
                LARGE_GRADIENT,
                seen_in_ten_views(1e-3),
                PositionGradient::default(),
            ],
            100,
            false,
        );
        let kinds: Vec<_> = found.iter().map(|d| (d.source, d.new)).collect();
        assert_eq!(kinds, [(0, false), (3, false), (4, false), (0, true), (1, true), (1, true)]);
        assert_eq!(found[3].row, rows[0]);
        for part in &found[4..] {
            let shrunk = rows[1].log_scale[0] - part.row.log_scale[0];
            assert!((shrunk - 1.6_f32.ln()).abs() < 1e-6);
            let rest = |row: &GeometryRow| (row.quat, row.opacity_logit);
            assert_eq!(rest(&part.row), rest(&rows[1]));
        }
    }

    #[test]
    fn parts_are_distributed_like_their_source() {
        let source = row(0.6, 0.01);
        let mut random = Pcg64::seed_from_u64(2);
        let parts: Vec<_> = (0..4_000).map(|_| part(&source, &mut random)).collect();
        let spread = |axis: usize| {
            let off = |part: &GeometryRow| part.mean[axis] - source.mean[axis];
            let sum: f32 = parts.iter().map(|part| off(part).powi(2)).sum();
            (sum / parts.len() as f32).sqrt()
        };
        for (axis, expected) in [(0, 0.01), (1, 0.1), (2, 0.01)] {
            assert!((spread(axis) / expected - 1.0).abs() < 0.05, "{axis}: {}", spread(axis));
        }
    }

    #[test]
    fn the_cap_keeps_large_gradients_and_a_reset_removes_by_size() {
        let rows = [row(0.6, 0.05); 4];
        let gradients = [0.01, 0.04, 0.02, 0.03].map(seen_in_ten_views);
        let found = after(&rows, &gradients, 6, false);
        let new: Vec<_> = found.iter().filter(|d| d.new).map(|d| d.source).collect();
        assert_eq!((found.len(), new), (6, vec![1, 1, 3, 3]));
        let mixed = [row(0.6, 0.05), row(0.6, 1e-3)];
        let small: Vec<_> = after(&mixed, &[PositionGradient::default(); 2], 6, true)
            .iter()
            .map(|d| d.source)
            .collect();
        assert_eq!(small, [1]);
        assert_eq!(
            after(&rows, &gradients, 2, true).len(),
            4,
            "without a survivor everything stays"
        );
    }

    #[test]
    fn a_large_one_is_split_before_it_is_judged_by_its_size() {
        let (large, giant) = (row(0.6, 0.015), row(0.6, 0.05));
        let found = after(&[large, giant], &[LARGE_GRADIENT; 2], 9, true);
        let kinds: Vec<_> = found.iter().map(|d| (d.source, d.new)).collect();
        assert_eq!(kinds, [(0, true), (0, true)], "0.15 becomes 0.094, and 0.5 becomes 0.31");
        assert_eq!(after(&[row(0.001, 0.05)], &[LARGE_GRADIENT], 9, false).len(), 1);
    }

    #[test]
    fn a_reset_lowers_opacities_and_raises_none() {
        let opacity = |logit: f32| 1.0 / (1.0 + (-logit).exp());
        assert!((opacity(reset(3.0)) - 0.01).abs() < 1e-6);
        assert_eq!(reset(-7.0), -7.0);
    }
}
