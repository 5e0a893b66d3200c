use super::*;
use proptest::prelude::*;

const ANCHOR: Anchor = Anchor::Equalised { alpha: 10.0, gamma: 0.8 };

/// The grey picture of tests/golden/clahe.py: a linear congruence, squared twice to be dark, then
/// one pixel of each value.
fn golden_values() -> Vec<u8> {
    let mut state = 1_u32;
    let dark = (0..3072 - 256).map(|_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let uniform = state >> 16;
        let squared = (uniform * uniform) >> 16;
        ((((u64::from(squared) * u64::from(squared)) >> 16) * 200) >> 16) as u8
    });
    dark.collect::<Vec<_>>().into_iter().chain(0..=255).collect()
}

/// The same table in integers, as OpenCV computes it: the excess is spread in whole counts, the
/// remainder at even distances.
fn integer_table(values: &[u8], alpha: f64) -> [u8; BINS] {
    let mut counts = [0_i64; BINS];
    values.iter().for_each(|&v| counts[v as usize] += 1);
    let total = values.len() as i64;
    let limit = ((alpha * total as f64 / BINS as f64) as i64).max(1);
    let excess: i64 = counts.iter().map(|c| (c - limit).max(0)).sum();
    counts.iter_mut().for_each(|c| *c = (*c).min(limit) + excess / BINS as i64);
    let remainder = (excess % BINS as i64) as usize;
    if let Some(step) = BINS.checked_div(remainder) {
        (0..BINS).step_by(step).take(remainder).for_each(|k| counts[k] += 1);
    }
    let scale = 255.0_f32 / total as f32;
    let mut sum = 0;
    counts.map(|count| {
        sum += count;
        (sum as f32 * scale).round_ties_even().min(255.0) as u8
    })
}

#[test]
fn the_integer_table_is_opencvs_and_the_float_table_close() {
    let golden: serde_json::Value =
        serde_json::from_str(include_str!("../../../../tests/golden/clahe.json")).expect("JSON");
    let values = golden_values();
    let data: Vec<f32> =
        (0..3).flat_map(|_| values.iter().map(|&v| f32::from(v) / 255.0)).collect();
    let histogram = Histogram::of(&Image::from_planar(64, 48, data));
    for (name, expected) in golden.as_object().expect("one table an alpha") {
        let alpha: f64 = name.parse().expect("a number");
        let expected: Vec<u8> = serde_json::from_value(expected.clone()).expect("256 numbers");
        assert_eq!(integer_table(&values, alpha).as_slice(), expected, "alpha {alpha}");
        let float = histogram.equalisation(alpha).expect("a table");
        let worst = float.iter().zip(&expected).map(|(f, &e)| (f * 255.0 - f32::from(e)).abs());
        // The error of whole counts: half a step, the limit's fraction in each bin, and up to 64
        // counts of the remainder that are placed early (r - r^2 / 256 at r = 128).
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
fn the_curve_matches_that_of_the_networks_training() {
    let golden: serde_json::Value =
        serde_json::from_str(include_str!("../../../../tests/golden/tone_curve.json"))
            .expect("JSON");
    let photograph = golden_photograph();
    let histogram = Histogram::of(&photograph);
    for curve in golden["curves"].as_array().expect("a list") {
        let number = |key: &str| curve[key].as_f64().expect("a number");
        let anchor = Anchor::Equalised { alpha: number("alpha"), gamma: number("gamma") };
        let values: Vec<f32> = serde_json::from_value(curve["values"].clone()).expect("numbers");
        let bright = ToneCurve::new(&histogram, anchor).apply(&photograph);
        for (pixel, expected) in values.chunks_exact(3).enumerate() {
            let found = bright.get(pixel % 16, pixel / 16);
            let apart = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(apart <= 1e-6, "{anchor:?}, pixel {pixel}: {found:?} and {expected:?}");
        }
    }
    let expected: [f64; 2] =
        serde_json::from_value(golden["automatic"].clone()).expect("two numbers");
    let found = crate::enhance::resolve_target("auto-paper", &histogram).expect("a target");
    let Anchor::Equalised { alpha, gamma } = found else {
        panic!("{found:?}");
    };
    assert!((alpha - expected[0]).abs() <= 1e-6 && (gamma - expected[1]).abs() <= 1e-6);
}

#[test]
fn a_single_value_is_clipped_and_the_rest_spread_evenly() {
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
fn an_exposure_is_a_gain_that_bends_only_before_white() {
    let curve = ToneCurve::new(&Histogram::pooled([]), Anchor::exposure(3.0));
    let exposed = |light: f32| srgb_to_linear(curve.map_v(linear_to_srgb(light / 8.0)));
    for light in [0.0, 0.001, 0.1, 0.5, 0.84] {
        assert!((exposed(light) - light).abs() < 1e-5, "{light}");
    }
    assert!((0.96..1.0).contains(&exposed(1.0)));
    assert_eq!([1.2, 3.0, 8.0].map(exposed), [1.0; 3]);
    let [r, g, b] = curve.apply_colour([0.1, 0.05, 0.025]).map(srgb_to_linear);
    let [r0, g0, b0] = [0.1, 0.05, 0.025].map(srgb_to_linear);
    assert!((r / r0 - 8.0).abs() < 1e-3 && (g / g0 - 8.0).abs() < 1e-3);
    assert!((b / b0 - 8.0).abs() < 1e-3);
}

#[test]
fn hue_and_saturation_survive_the_equalisation() {
    let image = Image::from_planar(2, 1, vec![0.1, 0.02, 0.05, 0.01, 0.025, 0.015]);
    let curve =
        ToneCurve::new(&Histogram::of(&image), Anchor::Equalised { alpha: 10.0, gamma: 1.0 });
    let [r, g, b] = curve.apply_colour([0.1, 0.05, 0.025]);
    assert!(r > 0.2 && (g / r - 0.5).abs() < 1e-5 && (b / r - 0.25).abs() < 1e-5);
}

#[test]
fn alpha_zero_leaves_the_exponent_alone() {
    let image = Image::from_planar(1, 1, vec![0.25, 0.5, 0.04]);
    let curve =
        ToneCurve::new(&Histogram::of(&image), Anchor::Equalised { alpha: 0.0, gamma: 0.5 });
    let colour = curve.apply_colour([0.25, 0.5, 0.04]);
    assert!((colour[0] - 0.5).abs() < 1e-6 && (colour[2] - 0.2).abs() < 1e-6);
}

#[test]
fn black_and_nan_images_stay_finite() {
    for data in [vec![0.0; 12], vec![f32::NAN; 12], vec![-1.0; 12]] {
        let image = Image::from_planar(2, 2, data);
        let curve = ToneCurve::new(&Histogram::of(&image), ANCHOR);
        assert!(curve.apply_colour([0.0; 3]).iter().all(|v| v.is_finite()));
        assert!(curve.apply_colour([0.3, 0.2, 0.1]).iter().all(|v| v.is_finite()));
    }
    let nothing = ToneCurve::new(&Histogram::pooled([]), ANCHOR);
    assert!(nothing.apply_colour([0.3, 0.2, 0.1])[0].is_finite());
}

#[test]
fn the_slope_is_the_derivative_of_the_curve() {
    let image = Image::from_planar(1, 1, vec![0.25, 0.5, 0.04]);
    let curve =
        ToneCurve::new(&Histogram::of(&image), Anchor::Equalised { alpha: 0.0, gamma: 0.5 });
    assert!((curve.slope([0.25; 3])[1] - 1.0).abs() < 1e-3, "{:?}", curve.slope([0.25; 3]));
}

proptest! {
    #[test]
    fn the_curve_is_monotone_and_stays_in_range(
        values in prop::collection::vec(0.0_f32..1.0, 30),
        alpha in 0.0_f64..15.0,
        gamma in 0.3_f64..1.0,
    ) {
        let image = Image::from_planar(5, 2, values);
        let histogram = Histogram::of(&image);
        let exposure = Anchor::Exposure { ev: alpha - 3.0, black: 0.1 * gamma - 0.05 };
        for anchor in [Anchor::Equalised { alpha, gamma }, exposure] {
            let curve = ToneCurve::new(&histogram, anchor);
            let mapped: Vec<f32> = (0..=1000).map(|i| curve.map_v(i as f32 / 1000.0)).collect();
            prop_assert!(mapped.windows(2).all(|pair| pair[1] >= pair[0] - 1e-6));
            prop_assert!(mapped.iter().all(|v| (0.0..=1.0).contains(v)));
        }
    }

    #[test]
    fn pooling_weights_every_pixel_equally(values in prop::collection::vec(0.0_f32..1.0, 24)) {
        let image = Image::from_planar(4, 2, values);
        let histogram = Histogram::pooled([&image, &image]);
        prop_assert!((histogram.total() - 16.0).abs() < 1e-6);
        let once = Histogram::of(&image);
        let mut bins = once.bins().iter().zip(histogram.bins());
        prop_assert!(bins.all(|(a, b)| (2.0 * a - b).abs() < 1e-9));
    }
}
