//! The brightness of the last round.

use std::str::FromStr;

use super::anchors::{Anchor, FIRST_ALPHA, MAX_ALPHA, MIN_GAMMA, TargetError};
use super::curve::{Histogram, ToneCurve};
use crate::image::{linear_to_srgb, srgb_to_linear};

/// Range of the mean of V, pooled over all views, of the `auto` target: photographs of eleven
/// scenes have 0.46 to 0.67.
const MEAN_V: std::ops::RangeInclusive<f64> = 0.42..=0.58;

/// Share of the pixels that the `auto` target leaves below white, apart from those clipped in the
/// photographs themselves.
const BELOW_WHITE: f64 = 0.99;

/// V from which a photograph counts as clipped.
const CLIPPED: f64 = 0.98;

/// Mean of V, pooled over all views, that the `auto-paper` target aims at.
const PAPER_MEAN_V: f64 = 0.45;

/// Number of alphas, on a geometric scale, among which the `auto-paper` target chooses.
const PAPER_ALPHAS: u32 = 60;

/// The longest exposure of a target, stops.
const MOST_STOPS: f64 = 12.0;

/// The paper's P_0, nearly the identity.
const FIRST_PAPER: Anchor = Anchor::Equalised { alpha: FIRST_ALPHA, gamma: 1.0 };

/// The target P_N of the option `target`: `auto`, `auto-paper`, stops, `alpha,gamma`, or the name
/// of a LuSh scene. `dark` is the pooled histogram of the dark originals.
///
/// # Errors
/// [`TargetError`] when the text is none of these or out of range.
pub fn resolve_target(target: &str, dark: &Histogram) -> Result<Anchor, TargetError> {
    match Target::from_str(target)? {
        Target::Automatic => Ok(automatic(dark)),
        Target::AutomaticPaper => Ok(automatic_paper(dark)),
        Target::Fixed(anchor) => Ok(anchor),
    }
}

/// The values of the option `target`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// The exposure that a photographer would have chosen.
    Automatic,
    /// The anchor of the paper's family that is closest to a longer exposure.
    AutomaticPaper,
    /// A named anchor.
    Fixed(Anchor),
}

impl FromStr for Target {
    type Err = TargetError;

    fn from_str(text: &str) -> Result<Self, TargetError> {
        match text.trim() {
            text if text.eq_ignore_ascii_case("auto") => Ok(Self::Automatic),
            text if text.eq_ignore_ascii_case("auto-paper") => Ok(Self::AutomaticPaper),
            text => text.parse().map(Self::Fixed),
        }
    }
}

/// The exposure at which a hundredth of the pixels reaches white, limited so that the mean of V
/// stays in [`MEAN_V`]: lamps in a dark street may clip, and scenes without highlights are not
/// over-brightened. Leaves brighter photographs alone.
pub fn automatic(dark: &Histogram) -> Anchor {
    let exposed = |ev: f64| {
        let curve = ToneCurve::new(dark, Anchor::exposure(ev));
        dark.mean_through(&curve)
    };
    let stops_to = |mean: f64| bisect(0.0, MOST_STOPS, |ev| exposed(ev) <= mean);
    let brightest = f64::from(srgb_to_linear(dark.quantile_below(BELOW_WHITE, CLIPPED) as f32));
    let to_white = -brightest.max(f64::MIN_POSITIVE).log2();
    let (least, most) = (stops_to(*MEAN_V.start()), stops_to(*MEAN_V.end()));
    Anchor::exposure(to_white.clamp(least, most))
}

/// The anchor of the paper's family whose curve is closest to a longer exposure. Alpha is not fixed
/// at 10 with a fitted gamma: of all curves with the wanted mean, the steepest ones crush dark
/// parts and lift their noise, while a dark photograph lacks exposure. The wanted exposure is the
/// gain of light that brings the mean of V to [`PAPER_MEAN_V`]; of the anchors with the same mean,
/// the one with the least squared difference over the histogram is chosen. If no anchor in range
/// reaches the mean, the nearest mean wins. Photographs that are already bright enough stay nearly
/// unchanged.
fn automatic_paper(dark: &Histogram) -> Anchor {
    if dark.mean_of(|v| v) >= PAPER_MEAN_V {
        return FIRST_PAPER;
    }
    let exposed = |gain: f64| {
        move |v: f64| {
            f64::from(linear_to_srgb((gain * f64::from(srgb_to_linear(v as f32))) as f32)).min(1.0)
        }
    };
    let stops = bisect(0.0, MOST_STOPS, |ev| dark.mean_of(exposed(ev.exp2())) <= PAPER_MEAN_V);
    let wanted = exposed(stops.exp2());
    let candidates = (0..=PAPER_ALPHAS).map(|k| {
        let share = f64::from(k) / f64::from(PAPER_ALPHAS);
        let alpha = FIRST_ALPHA * (MAX_ALPHA / FIRST_ALPHA).powf(share);
        let mean =
            |gamma| dark.mean_through(&ToneCurve::new(dark, Anchor::Equalised { alpha, gamma }));
        let gamma = bisect(1.0, MIN_GAMMA, |gamma| mean(gamma) <= PAPER_MEAN_V);
        let anchor = Anchor::Equalised { alpha, gamma };
        let curve = ToneCurve::new(dark, anchor);
        let difference = dark.mean_of(|v| (f64::from(curve.map_v(v as f32)) - wanted(v)).powi(2));
        // Bisection leaves an error of a thousandth; beyond that the mean comes first.
        let missed = (mean(gamma) - PAPER_MEAN_V).abs();
        (if missed < 1e-3 { 0.0 } else { missed }, difference, anchor)
    });
    candidates
        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)))
        .map_or(FIRST_PAPER, |(_, _, anchor)| anchor)
}

/// The point between `holds` and `fails` where a condition that holds on the side of `holds` ceases
/// to hold; `fails` if it holds everywhere, and `holds` if it holds nowhere.
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
        let data =
            (0..3 * 4096).map(|i| level * (((i * 7919) % 4099) as f32 / 4099.0).powi(2)).collect();
        Histogram::of(&Image::from_planar(64, 64, data))
    }

    fn mean(histogram: &Histogram, target: Anchor) -> f64 {
        histogram.mean_through(&ToneCurve::new(histogram, target))
    }

    /// A picture with every level, and the same at a fifteenth of the light.
    fn bright_and_dark() -> (Image, Image) {
        let levels = (0..3 * 4096).map(|i| ((i * 7919) % 4099) as f32 / 4099.0);
        let bright = Image::from_planar(64, 64, levels.collect());
        let light = bright.to_linear().data().iter().map(|v| v / 15.0).collect();
        (bright, Image::<Linear>::from_planar(64, 64, light).to_srgb())
    }

    #[test]
    fn the_automatic_target_undoes_a_short_exposure() {
        let (bright, dark) = bright_and_dark();
        let histogram = Histogram::of(&dark);
        let target = resolve_target("auto", &histogram).expect("auto");
        let Anchor::Exposure { ev, .. } = target else {
            panic!("{target:?}");
        };
        // V of three independent channels has a mean of 0.75, so the limit of the mean applies.
        assert!(ev < 15.0_f64.log2() && mean(&histogram, target) < 0.581);
        let out = ToneCurve::new(&histogram, Anchor::exposure(15.0_f64.log2())).apply(&dark);
        let apart = out.data().iter().zip(bright.data());
        let worst = apart.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 0.02, "{worst}");
    }

    #[test]
    fn the_automatic_target_brightens_a_hundredth_to_white() {
        // A fiftieth at a tenth of the light, the rest at a fortieth: 3.3 stops to white.
        let value = |light: f32| linear_to_srgb(light);
        let plane = |_| (0..1000).map(|i| value(if i % 50 == 0 { 0.1 } else { 0.025 }));
        let data = (0..3).flat_map(plane).collect();
        let histogram = Histogram::of(&Image::from_planar(100, 10, data));
        let Anchor::Exposure { ev, black } = automatic(&histogram) else {
            panic!("the paper's family");
        };
        assert!((ev - 10.0_f64.log2()).abs() < 0.05 && black == 0.0, "{ev}");
    }

    #[test]
    fn clipped_lamps_do_not_keep_a_street_dark() {
        let value = |i: usize| if i.is_multiple_of(10) { 1.0 } else { 0.04 };
        let histogram = Histogram::of(&Image::from_planar(
            100,
            10,
            (0..3).flat_map(|_| (0..1000).map(value)).collect(),
        ));
        let target = automatic(&histogram);
        assert!(mean(&histogram, target) > 0.41, "{target:?}");
    }

    #[test]
    fn the_papers_automatic_target_reaches_its_mean() {
        for level in [0.02, 0.05, 0.2, 0.6, 1.0] {
            let histogram = dark(level);
            let target = resolve_target("auto-paper", &histogram).expect("auto-paper");
            let mean = mean(&histogram, target);
            assert!(
                target == FIRST_PAPER || (mean - PAPER_MEAN_V).abs() < 1e-3,
                "{level}: {target:?} gives {mean}"
            );
            assert_eq!(target == FIRST_PAPER, level == 1.0);
        }
    }

    #[test]
    fn the_papers_target_beats_the_steepest_curve() {
        let (bright, dark) = bright_and_dark();
        let histogram = Histogram::of(&dark);
        let target = resolve_target("auto-paper", &histogram).expect("auto-paper");
        let steep = |gamma| Anchor::Equalised { alpha: 10.0, gamma };
        let steepest =
            steep(bisect(1.0, MIN_GAMMA, |gamma| mean(&histogram, steep(gamma)) <= PAPER_MEAN_V));
        // With the best gain against the bright picture, whose mean differs from the target's.
        let error = |anchor: Anchor| {
            let curve = ToneCurve::new(&histogram, anchor);
            let out = curve.apply(&dark);
            let pairs = || {
                out.data().iter().zip(bright.data()).map(|(&a, &b)| (f64::from(a), f64::from(b)))
            };
            let scale =
                pairs().map(|(a, b)| a * b).sum::<f64>() / pairs().map(|(a, _)| a * a).sum::<f64>();
            pairs().map(|(a, b)| (scale * a - b).powi(2)).sum::<f64>()
        };
        let (ours, theirs) = (error(target), error(steepest));
        assert!(ours < 0.5 * theirs, "{target:?} {ours} against {steepest:?} {theirs}");
    }

    #[test]
    fn bright_pictures_are_left_alone() {
        let histogram = Histogram::of(&Image::from_planar(8, 8, vec![0.8; 3 * 64]));
        let target = |text| resolve_target(text, &histogram).expect("a target");
        assert_eq!(target("auto"), Anchor::exposure(0.0));
        assert_eq!(target("auto-paper"), FIRST_PAPER);
    }

    #[test]
    fn targets_are_stops_pairs_or_names() {
        let histogram = dark(0.1);
        for (text, alpha, gamma) in [("10, 0.8", 10.0, 0.8), ("Car", 0.0, 0.25)] {
            let expected = Anchor::Equalised { alpha, gamma };
            assert_eq!(resolve_target(text, &histogram), Ok(expected));
        }
        for (text, ev) in [("+3.5EV", 3.5), ("2 ev", 2.0), ("-1ev", -1.0)] {
            assert_eq!(resolve_target(text, &histogram), Ok(Anchor::exposure(ev)));
        }
        for wrong in
            ["", "bright", "10", "10,0", "-1,0.5", "nan,1", "10,0.8,3", "ev", "40EV", "nanEV"]
        {
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
