//! The histogram of V and the tone curve that it gives.

use crate::image::{Image, Srgb};

use super::Anchor;

/// Bins of the histogram and entries of the table. alpha's meaning depends on this count: with
/// 1024 bins, alpha 10 brightens to a mean of 0.29 instead of 0.51.
pub const BINS: usize = 256;

/// Below this V an image holds no hue worth keeping; keeps the gain finite.
const SMALLEST_V: f32 = 1e-4;

/// Where a V between 0 and 1 falls: the lower of its two bins and the share of the upper one.
/// What is not a number counts as black.
fn bin(v: f32) -> (usize, f32) {
    let position = if v > 0.0 {
        v.min(1.0) * (BINS - 1) as f32
    } else {
        0.0
    };
    let low = (position as usize).min(BINS - 2);
    (low, position - low as f32)
}

/// V of HSV: the largest channel.
pub(super) fn value(rgb: [f32; 3]) -> f32 {
    rgb[0].max(rgb[1]).max(rgb[2])
}

/// How often each V occurs, each pixel shared linearly between its two bins.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    bins: [f64; BINS],
}

impl Histogram {
    /// Of one image.
    pub fn of(image: &Image<Srgb>) -> Self {
        Self::pooled([image])
    }

    /// Of all images together: every pixel weighs the same.
    pub fn pooled<'a>(images: impl IntoIterator<Item = &'a Image<Srgb>>) -> Self {
        let mut histogram = Self { bins: [0.0; BINS] };
        images.into_iter().for_each(|image| histogram.add(image));
        histogram
    }

    /// Adds an image's pixels.
    pub fn add(&mut self, image: &Image<Srgb>) {
        let (red, green, blue) = (image.plane(0), image.plane(1), image.plane(2));
        for ((&r, &g), &b) in red.iter().zip(green).zip(blue) {
            let (low, share) = bin(value([r, g, b]));
            self.bins[low] += f64::from(1.0 - share);
            self.bins[low + 1] += f64::from(share);
        }
    }

    /// The counts, [256].
    pub fn bins(&self) -> &[f64; BINS] {
        &self.bins
    }

    /// Pixels counted.
    pub fn total(&self) -> f64 {
        self.bins.iter().sum()
    }

    /// The mean of V after a curve; 0 when nothing was counted.
    pub fn mean_through(&self, curve: &ToneCurve) -> f64 {
        self.mean_of(|v| f64::from(curve.map_v(v as f32)))
    }

    /// The mean of a function of V; 0 when nothing was counted.
    pub fn mean_of(&self, function: impl Fn(f64) -> f64) -> f64 {
        let mapped = |(k, count): (usize, &f64)| count * function(k as f64 / (BINS - 1) as f64);
        let total = self.total();
        if total > 0.0 {
            self.bins.iter().enumerate().map(mapped).sum::<f64>() / total
        } else {
            0.0
        }
    }

    /// The table of the equalisation with clip limit `alpha` (method 1): entries in 0..=1,
    /// ascending. `None` for alpha = 0 and where nothing was counted.
    fn equalisation(&self, alpha: f64) -> Option<[f32; BINS]> {
        let total = self.total();
        if alpha <= 0.0 || total <= 0.0 {
            return None;
        }
        let limit = (alpha * total / BINS as f64).max(1.0);
        let excess: f64 = self.bins.iter().map(|count| (count - limit).max(0.0)).sum();
        let mut sum = 0.0;
        // One redistribution pass, not iterated: a bin may end slightly above the limit.
        Some(self.bins.map(|count| {
            sum += count.min(limit) + excess / BINS as f64;
            (sum / total) as f32
        }))
    }
}

/// E(.; alpha, gamma) for one histogram: a monotone curve on V that keeps hue and saturation,
/// then an exponent.
#[derive(Clone, Debug, PartialEq)]
pub struct ToneCurve {
    table: Option<Box<[f32; BINS]>>,
    gamma: f32,
}

impl ToneCurve {
    /// The curve of an anchor over a histogram: pooled for one tone in the whole scene, of one
    /// image for the paper's reading.
    pub fn new(histogram: &Histogram, anchor: Anchor) -> Self {
        Self {
            table: histogram.equalisation(anchor.alpha).map(Box::new),
            gamma: anchor.gamma as f32,
        }
    }

    /// The equalisation's V' before the exponent.
    fn equalised(&self, v: f32) -> f32 {
        let Some(table) = &self.table else { return v };
        let (low, share) = bin(v);
        table[low] + share * (table[low + 1] - table[low])
    }

    /// What all channels of a colour are multiplied with before the exponent.
    pub(super) fn gain(&self, v: f32) -> f32 {
        if self.table.is_some() {
            self.equalised(v) / v.max(SMALLEST_V)
        } else {
            1.0
        }
    }

    /// The exponent on a value, clipped first.
    pub(super) fn power(&self, value: f32) -> f32 {
        value.clamp(0.0, 1.0).powf(self.gamma)
    }

    /// What V becomes, in 0..=1: monotone.
    pub fn map_v(&self, v: f32) -> f32 {
        self.power(self.equalised(v))
    }

    /// What a colour becomes, each channel in 0..=1. Takes any finite colour: negative channels
    /// end at 0.
    pub fn apply_colour(&self, rgb: [f32; 3]) -> [f32; 3] {
        let gain = self.gain(value(rgb));
        rgb.map(|channel| self.power(channel * gain))
    }

    /// How strongly each channel answers to a small change of that channel alone, at a colour:
    /// the factor for what varies around it, such as the view-dependent part of a Gaussian's
    /// colour. Central differences over one 8-bit step; 0 where the curve clips.
    pub fn slope(&self, rgb: [f32; 3]) -> [f32; 3] {
        const STEP: f32 = 0.5 / 255.0;
        std::array::from_fn(|channel| {
            let at = |offset: f32| {
                let mut moved = rgb;
                moved[channel] = (moved[channel] + offset).clamp(0.0, 1.0);
                (moved[channel], self.apply_colour(moved)[channel])
            };
            let ((x0, y0), (x1, y1)) = (at(-STEP), at(STEP));
            if x1 > x0 { (y1 - y0) / (x1 - x0) } else { 0.0 }
        })
    }

    /// The image through the curve.
    pub fn apply(&self, image: &Image<Srgb>) -> Image<Srgb> {
        let mut out = Image::new(image.width(), image.height());
        let n = image.pixels();
        let (red, rest) = out.data_mut().split_at_mut(n);
        let (green, blue) = rest.split_at_mut(n);
        for i in 0..n {
            let colour = [image.plane(0)[i], image.plane(1)[i], image.plane(2)[i]];
            [red[i], green[i], blue[i]] = self.apply_colour(colour);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ANCHOR: Anchor = Anchor {
        alpha: 10.0,
        gamma: 0.8,
    };

    /// The grey picture of tests/golden/clahe.py: a linear congruence, squared twice to be dark,
    /// then one pixel of every value.
    fn golden_values() -> Vec<u8> {
        let mut state = 1_u32;
        let dark = (0..3072 - 256).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let uniform = state >> 16;
            let squared = (uniform * uniform) >> 16;
            ((((u64::from(squared) * u64::from(squared)) >> 16) * 200) >> 16) as u8
        });
        dark.collect::<Vec<_>>()
            .into_iter()
            .chain(0..=255)
            .collect()
    }

    /// The same table in whole numbers, as OpenCV computes it: the excess is spread in whole
    /// counts, the remainder at even distances.
    fn integer_table(values: &[u8], alpha: f64) -> [u8; BINS] {
        let mut counts = [0_i64; BINS];
        values.iter().for_each(|&v| counts[v as usize] += 1);
        let total = values.len() as i64;
        let limit = ((alpha * total as f64 / BINS as f64) as i64).max(1);
        let excess: i64 = counts.iter().map(|c| (c - limit).max(0)).sum();
        counts
            .iter_mut()
            .for_each(|c| *c = (*c).min(limit) + excess / BINS as i64);
        let remainder = (excess % BINS as i64) as usize;
        if let Some(step) = BINS.checked_div(remainder) {
            (0..BINS)
                .step_by(step)
                .take(remainder)
                .for_each(|k| counts[k] += 1);
        }
        let scale = 255.0_f32 / total as f32;
        let mut sum = 0;
        counts.map(|count| {
            sum += count;
            (sum as f32 * scale).round_ties_even().min(255.0) as u8
        })
    }

    #[test]
    fn the_integer_table_is_opencvs_bit_for_bit_and_the_float_table_follows_it() {
        let golden: serde_json::Value =
            serde_json::from_str(include_str!("../../../tests/golden/clahe.json")).expect("JSON");
        let values = golden_values();
        let data: Vec<f32> = (0..3)
            .flat_map(|_| values.iter().map(|&v| f32::from(v) / 255.0))
            .collect();
        let histogram = Histogram::of(&Image::from_planar(64, 48, data));
        for (name, expected) in golden.as_object().expect("one table an alpha") {
            let alpha: f64 = name.parse().expect("a number");
            let expected: Vec<u8> = serde_json::from_value(expected.clone()).expect("256 numbers");
            assert_eq!(
                integer_table(&values, alpha).as_slice(),
                expected,
                "alpha {alpha}"
            );
            let float = histogram.equalisation(alpha).expect("a table");
            let worst = float
                .iter()
                .zip(&expected)
                .map(|(f, &e)| (f * 255.0 - f32::from(e)).abs());
            // What whole counts cost: half a step, the limit's fraction in each bin, and up to 64
            // counts of the remainder that come early (r - r^2 / 256 at r = 128).
            let limit = (alpha * values.len() as f64 / BINS as f64).max(1.0);
            let counts = 64.0 + BINS as f32 * limit.fract() as f32;
            let allowed = 0.5 + counts * 255.0 / values.len() as f32;
            let worst = worst.fold(0.0, f32::max);
            assert!(worst <= allowed, "alpha {alpha}: {worst} of {allowed}");
        }
    }

    /// The photograph of tests/golden/tone_curve.py.
    fn golden_photograph() -> Image<Srgb> {
        let (mut state, mut photograph) = (7_u32, Image::new(16, 8));
        for pixel in 0..16 * 8 {
            let rgb = [0; 3].map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let uniform = f64::from(state >> 8) / f64::from(1 << 24);
                (0.4 * uniform * uniform) as f32
            });
            photograph.set(pixel % 16, pixel / 16, rgb);
        }
        photograph
    }

    #[test]
    fn networks_are_trained_on_photographs_through_the_same_curve() {
        let golden: serde_json::Value =
            serde_json::from_str(include_str!("../../../tests/golden/tone_curve.json"))
                .expect("JSON");
        let photograph = golden_photograph();
        let histogram = Histogram::of(&photograph);
        for curve in golden["curves"].as_array().expect("a list") {
            let number = |key: &str| curve[key].as_f64().expect("a number");
            let anchor = Anchor {
                alpha: number("alpha"),
                gamma: number("gamma"),
            };
            let values: Vec<f32> =
                serde_json::from_value(curve["values"].clone()).expect("numbers");
            let bright = ToneCurve::new(&histogram, anchor).apply(&photograph);
            for (pixel, expected) in values.chunks_exact(3).enumerate() {
                let found = bright.get(pixel % 16, pixel / 16);
                let apart = found
                    .iter()
                    .zip(expected)
                    .map(|(a, b)| (a - b).abs())
                    .fold(0.0, f32::max);
                assert!(
                    apart <= 1e-6,
                    "{anchor:?}, pixel {pixel}: {found:?} and {expected:?}"
                );
            }
        }
        let expected: [f64; 2] =
            serde_json::from_value(golden["automatic"].clone()).expect("two numbers");
        let found = super::super::resolve_target("auto", &histogram).expect("a target");
        assert!(
            (found.alpha - expected[0]).abs() <= 1e-6 && (found.gamma - expected[1]).abs() <= 1e-6
        );
    }

    #[test]
    fn a_single_value_keeps_its_limit_and_spreads_the_rest_evenly() {
        let grey = 51.0 / 255.0;
        let histogram = Histogram::of(&Image::from_planar(16, 16, vec![grey; 3 * 256]));
        let table = histogram.equalisation(10.0).expect("a table");
        let even = 246.0 / 256.0 / 256.0;
        assert!((table[0] - even).abs() < 1e-6);
        assert!((table[50] - 51.0 * even).abs() < 1e-5);
        assert!((table[52] - (53.0 * even + 10.0 / 256.0)).abs() < 1e-5);
        assert!((table[255] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn hue_and_saturation_survive_the_equalisation() {
        let image = Image::from_planar(2, 1, vec![0.1, 0.02, 0.05, 0.01, 0.025, 0.015]);
        let curve = ToneCurve::new(
            &Histogram::of(&image),
            Anchor {
                alpha: 10.0,
                gamma: 1.0,
            },
        );
        let [r, g, b] = curve.apply_colour([0.1, 0.05, 0.025]);
        assert!(r > 0.2 && (g / r - 0.5).abs() < 1e-5 && (b / r - 0.25).abs() < 1e-5);
    }

    #[test]
    fn alpha_zero_is_the_exponent_alone() {
        let image = Image::from_planar(1, 1, vec![0.25, 0.5, 0.04]);
        let curve = ToneCurve::new(
            &Histogram::of(&image),
            Anchor {
                alpha: 0.0,
                gamma: 0.5,
            },
        );
        let colour = curve.apply_colour([0.25, 0.5, 0.04]);
        assert!((colour[0] - 0.5).abs() < 1e-6 && (colour[2] - 0.2).abs() < 1e-6);
    }

    #[test]
    fn black_images_and_images_without_a_number_stay_finite() {
        for data in [vec![0.0; 12], vec![f32::NAN; 12], vec![-1.0; 12]] {
            let image = Image::from_planar(2, 2, data);
            let curve = ToneCurve::new(&Histogram::of(&image), ANCHOR);
            assert!(curve.apply_colour([0.0; 3]).iter().all(|v| v.is_finite()));
            assert!(
                curve
                    .apply_colour([0.3, 0.2, 0.1])
                    .iter()
                    .all(|v| v.is_finite())
            );
        }
        let nothing = ToneCurve::new(&Histogram::pooled([]), ANCHOR);
        assert!(nothing.apply_colour([0.3, 0.2, 0.1])[0].is_finite());
    }

    #[test]
    fn the_slope_is_the_derivative_of_the_curve() {
        let image = Image::from_planar(1, 1, vec![0.25, 0.5, 0.04]);
        let curve = ToneCurve::new(
            &Histogram::of(&image),
            Anchor {
                alpha: 0.0,
                gamma: 0.5,
            },
        );
        assert!(
            (curve.slope([0.25; 3])[1] - 1.0).abs() < 1e-3,
            "{:?}",
            curve.slope([0.25; 3])
        );
    }

    proptest! {
        #[test]
        fn the_curve_is_monotone_and_stays_in_range(
            values in prop::collection::vec(0.0_f32..1.0, 30),
            alpha in 0.0_f64..15.0,
            gamma in 0.3_f64..1.0,
        ) {
            let image = Image::from_planar(5, 2, values);
            let curve = ToneCurve::new(&Histogram::of(&image), Anchor { alpha, gamma });
            let mapped: Vec<f32> = (0..=1000).map(|i| curve.map_v(i as f32 / 1000.0)).collect();
            prop_assert!(mapped.windows(2).all(|pair| pair[1] >= pair[0] - 1e-6));
            prop_assert!(mapped.iter().all(|v| (0.0..=1.0).contains(v)));
        }

        #[test]
        fn pooling_weighs_every_pixel_the_same(values in prop::collection::vec(0.0_f32..1.0, 24)) {
            let image = Image::from_planar(4, 2, values);
            let histogram = Histogram::pooled([&image, &image]);
            prop_assert!((histogram.total() - 16.0).abs() < 1e-6);
            let once = Histogram::of(&image);
            let mut bins = once.bins().iter().zip(histogram.bins());
            prop_assert!(bins.all(|(a, b)| (2.0 * a - b).abs() < 1e-9));
        }
    }
}
