//! The brightness that the last round ends at.

use super::anchors::{Anchor, FIRST, MAX_ALPHA, MIN_GAMMA, TargetError};
use super::curve::{Histogram, ToneCurve};
use crate::image::{linear_to_srgb, srgb_to_linear};

/// Mean of V that the `auto` target aims at, pooled over all views.
pub const AUTO_MEAN_V: f64 = 0.45;

/// Steps of alpha, on a geometric scale, among which the `auto` target chooses.
const AUTO_ALPHAS: u32 = 60;

/// The longest exposure that the `auto` target makes up for.
const MOST_EXPOSURE: f64 = 4096.0;

/// The target P_N of the option `target`: `auto`, `alpha,gamma`, or the name of a LuSh scene.
/// `dark` is the pooled histogram of the dark originals.
///
/// # Errors
/// [`TargetError`] when the text is none of these or out of range.
pub fn resolve_target(target: &str, dark: &Histogram) -> Result<Anchor, TargetError> {
    let text = target.trim();
    if text.eq_ignore_ascii_case("auto") {
        return Ok(automatic(dark));
    }
    text.parse()
}

/// The anchor whose curve is closest to a longer exposure. Not at alpha 10 with gamma to
/// fit: of all curves with the wanted mean the steepest crush what is dark and lift its noise; a
/// longer exposure is what the dark photograph lacks. So: the gain of light that brings the mean of
/// V to [`AUTO_MEAN_V`], and of the anchors that bring it there too the one with the least squared
/// difference over the histogram. Where no anchor in range reaches the mean, as near to it as they
/// come. What is bright enough already is left nearly alone.
fn automatic(dark: &Histogram) -> Anchor {
    if dark.mean_of(|v| v) >= AUTO_MEAN_V {
        return FIRST;
    }
    let exposed = |gain: f64| {
        move |v: f64| {
            f64::from(linear_to_srgb(
                (gain * f64::from(srgb_to_linear(v as f32))) as f32,
            ))
            .min(1.0)
        }
    };
    let exponent = bisect(0.0, MOST_EXPOSURE.ln(), |e| {
        dark.mean_of(exposed(e.exp())) <= AUTO_MEAN_V
    });
    let wanted = exposed(exponent.exp());
    let candidates = (0..=AUTO_ALPHAS).map(|k| {
        let share = f64::from(k) / f64::from(AUTO_ALPHAS);
        let alpha = FIRST.alpha * (MAX_ALPHA / FIRST.alpha).powf(share);
        let mean = |gamma| dark.mean_through(&ToneCurve::new(dark, Anchor { alpha, gamma }));
        let gamma = bisect(1.0, MIN_GAMMA, |gamma| mean(gamma) <= AUTO_MEAN_V);
        let anchor = Anchor { alpha, gamma };
        let curve = ToneCurve::new(dark, anchor);
        let difference = dark.mean_of(|v| (f64::from(curve.map_v(v as f32)) - wanted(v)).powi(2));
        // A thousandth is what bisection leaves; beyond it the mean comes first.
        let missed = (mean(gamma) - AUTO_MEAN_V).abs();
        (if missed < 1e-3 { 0.0 } else { missed }, difference, anchor)
    });
    candidates
        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)))
        .map_or(FIRST, |(_, _, anchor)| anchor)
}

/// The point between `holds` and `fails` where a condition that holds on the side of `holds`
/// stops to hold; `fails` when it holds everywhere, and `holds` when it holds nowhere.
fn bisect(mut holds: f64, mut fails: f64, condition: impl Fn(f64) -> bool) -> f64 {
    if condition(fails) {
        return fails;
    }
    for _ in 0..40 {
        let middle = 0.5 * (holds + fails);
        if condition(middle) {
            holds = middle;
        } else {
            fails = middle;
        }
    }
    holds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Image, Linear};

    fn dark(level: f32) -> Histogram {
        let data = (0..3 * 4096)
            .map(|i| level * (((i * 7919) % 4099) as f32 / 4099.0).powi(2))
            .collect();
        Histogram::of(&Image::from_planar(64, 64, data))
    }

    #[test]
    fn the_automatic_target_brings_the_mean_to_its_aim() {
        for level in [0.02, 0.05, 0.2, 0.6, 1.0] {
            let histogram = dark(level);
            let target = resolve_target("auto", &histogram).expect("auto");
            let mean = histogram.mean_through(&ToneCurve::new(&histogram, target));
            assert!(
                target == FIRST || (mean - AUTO_MEAN_V).abs() < 1e-3,
                "{level}: {target:?} gives {mean}"
            );
            assert_eq!(target == FIRST, level == 1.0);
            assert!(
                (MIN_GAMMA..=1.0).contains(&target.gamma)
                    && (0.1..=MAX_ALPHA).contains(&target.alpha)
            );
        }
    }

    #[test]
    fn the_automatic_target_is_closer_to_a_longer_exposure_than_the_steepest_curve() {
        let bright = Image::from_planar(
            64,
            64,
            (0..3 * 4096)
                .map(|i| ((i * 7919) % 4099) as f32 / 4099.0)
                .collect(),
        );
        let light = bright.to_linear();
        let dark =
            Image::<Linear>::from_planar(64, 64, light.data().iter().map(|v| v / 15.0).collect())
                .to_srgb();
        let histogram = Histogram::of(&dark);
        let target = resolve_target("auto", &histogram).expect("auto");
        let steep = |gamma| Anchor { alpha: 10.0, gamma };
        let mean = |anchor| histogram.mean_through(&ToneCurve::new(&histogram, anchor));
        let steepest = steep(bisect(1.0, MIN_GAMMA, |gamma| {
            mean(steep(gamma)) <= AUTO_MEAN_V
        }));
        // Best gain against the bright picture, whose mean is not the target's.
        let error = |anchor: Anchor| {
            let curve = ToneCurve::new(&histogram, anchor);
            let out = curve.apply(&dark);
            let pairs = || {
                out.data()
                    .iter()
                    .zip(bright.data())
                    .map(|(&a, &b)| (f64::from(a), f64::from(b)))
            };
            let scale =
                pairs().map(|(a, b)| a * b).sum::<f64>() / pairs().map(|(a, _)| a * a).sum::<f64>();
            pairs().map(|(a, b)| (scale * a - b).powi(2)).sum::<f64>()
        };
        let (ours, theirs) = (error(target), error(steepest));
        assert!(
            ours < 0.5 * theirs,
            "{target:?} {ours} against {steepest:?} {theirs}"
        );
    }

    #[test]
    fn pictures_that_are_bright_already_are_left_nearly_alone() {
        let data = vec![0.8; 3 * 64];
        let histogram = Histogram::of(&Image::from_planar(8, 8, data));
        let target = resolve_target("auto", &histogram).expect("auto");
        assert!(
            target.gamma == 1.0 && (target.alpha - 0.1).abs() < 1e-9,
            "{target:?}"
        );
    }

    #[test]
    fn targets_are_read_as_pairs_and_names_and_refused_with_the_known_ones() {
        let histogram = dark(0.1);
        assert_eq!(
            resolve_target("10, 0.8", &histogram),
            Ok(Anchor {
                alpha: 10.0,
                gamma: 0.8
            })
        );
        assert_eq!(
            resolve_target("Car", &histogram),
            Ok(Anchor {
                alpha: 0.0,
                gamma: 0.25
            })
        );
        for wrong in ["", "bright", "10", "10,0", "-1,0.5", "nan,1", "10,0.8,3"] {
            assert!(resolve_target(wrong, &histogram).is_err(), "{wrong}");
        }
        assert!(
            resolve_target("bright", &histogram)
                .expect_err("unknown")
                .to_string()
                .contains("sakura")
        );
    }
}
