//! Densification as first published, to compare with: Gaussians whose position the loss has a large
//! gradient by are cloned when small and split when large; transparent ones go. Kerbl et al., "3D
//! Gaussian Splatting for Real-Time Radiance Field Rendering", 2023, section 5.
//!
//! Opacities are reset every [`RESET_EVERY`] steps, as published: a round of fewer steps never
//! resets them, because it would end before they recover.

use glam::{Quat, Vec3};
use rand::Rng;

use super::{GeometryRow, MIN_OPACITY, opacity};
use crate::random::normal;

/// Mean length of the gradient by the position in normalised device coordinates above which a
/// Gaussian is too coarse.
const THRESHOLD: f32 = 2e-4;
/// Gaussians up to this share of the extent are cloned, larger ones split.
const SMALL: f64 = 0.01;
/// After a reset, Gaussians beyond this share of the extent go.
const LARGE: f64 = 0.1;
/// Into so many.
const PARTS: usize = 2;
/// Scales of the parts are divided by this: 0.8 times [`PARTS`].
const SHRINK: f32 = 1.6;
/// Steps between resets.
pub const RESET_EVERY: u32 = 3_000;
/// Opacities after a reset, at most.
const RESET_TO: f32 = 0.01;

/// What the steps since the last densification saw of a Gaussian: the sum of the lengths of its
/// gradients by position, in normalised device coordinates, and the number of views that showed it.
pub type PositionGradient = [f32; 2];

/// One Gaussian after a densification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Descendant {
    /// Whose harmonics it has.
    pub source: usize,
    /// Its geometry.
    pub row: GeometryRow,
    /// Whether it is new: Adam knows nothing about it.
    pub new: bool,
}

/// Decides a densification of `rows`, at most `cap` afterwards: those with the largest gradients
/// come first. Without a survivor everything stays. `after_reset`: whether opacities were reset
/// before, so that size means something.
pub fn plan(
    rows: &[GeometryRow],
    gradients: &[PositionGradient],
    cap: usize,
    extent: f64,
    after_reset: bool,
    random: &mut impl Rng,
) -> Vec<Descendant> {
    let largest = |row: &GeometryRow| f64::from(row[3].max(row[4]).max(row[5])).exp();
    let dies = |row: &GeometryRow| {
        opacity(row) < MIN_OPACITY || (after_reset && largest(row) > LARGE * extent)
    };
    let kept: Vec<usize> = (0..rows.len()).filter(|&i| !dies(&rows[i])).collect();
    let kept = if kept.is_empty() {
        (0..rows.len()).collect()
    } else {
        kept
    };
    let mean = |i: usize| gradients[i][0] / gradients[i][1].max(1.0);
    let mut coarse: Vec<usize> = kept
        .iter()
        .copied()
        .filter(|&i| mean(i) >= THRESHOLD)
        .collect();
    coarse.sort_by(|&a, &b| mean(b).total_cmp(&mean(a)).then(a.cmp(&b)));
    coarse.truncate(cap.saturating_sub(kept.len()));
    let splits = |i: &usize| largest(&rows[*i]) > SMALL * extent;
    let split: std::collections::BTreeSet<usize> = coarse.iter().copied().filter(splits).collect();
    let stays = kept.iter().filter(|i| !split.contains(i));
    let mut after: Vec<Descendant> = stays
        .map(|&source| Descendant {
            source,
            row: rows[source],
            new: false,
        })
        .collect();
    for &source in &coarse {
        if !split.contains(&source) {
            after.push(Descendant {
                source,
                row: rows[source],
                new: true,
            });
            continue;
        }
        for _ in 0..PARTS {
            after.push(Descendant {
                source,
                row: part(&rows[source], random),
                new: true,
            });
        }
    }
    after
}

/// A smaller Gaussian at a place drawn from `row`.
fn part(row: &GeometryRow, random: &mut impl Rng) -> GeometryRow {
    let scale = Vec3::new(row[3], row[4], row[5]).exp();
    let drawn = Vec3::from([0; 3].map(|_| normal(random) as f32));
    let rotation = Quat::from_xyzw(row[7], row[8], row[9], row[6]).normalize();
    let offset = rotation * (scale * drawn);
    let mut out = *row;
    for axis in 0..3 {
        out[axis] += offset[axis];
        out[3 + axis] -= SHRINK.ln();
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

    const LARGE_GRADIENT: PositionGradient = [0.01, 10.0];

    /// Ten times as long in its own x, which points along the world's y.
    fn row(opacity: f32, scale: f32) -> GeometryRow {
        let (s, logit) = (scale.ln(), (opacity / (1.0 - opacity)).ln());
        // A quarter turn about z; rows need not be normalised.
        [
            1.0,
            2.0,
            3.0,
            s + 10.0_f32.ln(),
            s,
            s,
            1.5,
            0.0,
            0.0,
            1.5,
            logit,
            0.0,
        ]
    }

    fn after(
        rows: &[GeometryRow],
        gradients: &[PositionGradient],
        cap: usize,
        after_reset: bool,
    ) -> Vec<Descendant> {
        plan(
            rows,
            gradients,
            cap,
            1.0,
            after_reset,
            &mut Pcg64::seed_from_u64(1),
        )
    }

    #[test]
    fn the_small_are_cloned_the_large_split_and_the_transparent_go() {
        let rows = [
            row(0.6, 1e-4),
            row(0.6, 0.05),
            row(0.001, 0.05),
            row(0.6, 1e-4),
            row(0.6, 1e-4),
        ];
        // The fourth has half the gradient that it takes, the last was never seen.
        let found = after(
            &rows,
            &[
                LARGE_GRADIENT,
                LARGE_GRADIENT,
                LARGE_GRADIENT,
                [1e-3, 10.0],
                [0.0, 0.0],
            ],
            100,
            false,
        );
        let kinds: Vec<_> = found.iter().map(|d| (d.source, d.new)).collect();
        assert_eq!(
            kinds,
            [
                (0, false),
                (3, false),
                (4, false),
                (0, true),
                (1, true),
                (1, true)
            ]
        );
        assert_eq!(found[3].row, rows[0]);
        for part in &found[4..] {
            assert!((part.row[3] - rows[1][3] + 1.6_f32.ln()).abs() < 1e-6);
            assert_eq!(part.row[6..], rows[1][6..]);
        }
    }

    #[test]
    fn parts_lie_where_their_source_is() {
        let source = row(0.6, 0.01);
        let mut random = Pcg64::seed_from_u64(2);
        let parts: Vec<_> = (0..4_000).map(|_| part(&source, &mut random)).collect();
        let spread = |axis: usize| {
            let sum: f32 = parts.iter().map(|p| (p[axis] - source[axis]).powi(2)).sum();
            (sum / parts.len() as f32).sqrt()
        };
        for (axis, expected) in [(0, 0.01), (1, 0.1), (2, 0.01)] {
            assert!(
                (spread(axis) / expected - 1.0).abs() < 0.05,
                "{axis}: {}",
                spread(axis)
            );
        }
    }

    #[test]
    fn the_cap_holds_for_the_largest_gradients_and_size_counts_after_a_reset() {
        let rows = [row(0.6, 0.05); 4];
        let gradients = [[0.01, 10.0], [0.04, 10.0], [0.02, 10.0], [0.03, 10.0]];
        let found = after(&rows, &gradients, 6, false);
        let new: Vec<_> = found.iter().filter(|d| d.new).map(|d| d.source).collect();
        assert_eq!((found.len(), new), (6, vec![1, 1, 3, 3]));
        let mixed = [row(0.6, 0.05), row(0.6, 1e-3)];
        let small: Vec<_> = after(&mixed, &[[0.0; 2]; 2], 6, true)
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
    fn a_reset_lowers_opacities_and_raises_none() {
        let opacity = |logit: f32| 1.0 / (1.0 + (-logit).exp());
        assert!((opacity(reset(3.0)) - 0.01).abs() < 1e-6);
        assert_eq!(reset(-7.0), -7.0);
    }
}
