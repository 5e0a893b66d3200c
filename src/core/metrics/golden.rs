//! Tests of the metrics against scikit-image and NumPy: `tests/golden/metrics.py` documents how it
//! computes the values, on images that [`picture`] and [`degraded`] generate by formula.

use serde::Deserialize;

use super::*;

#[derive(Clone, Deserialize)]
struct Golden {
    size: [usize; 2],
    change: [f64; 3],
    psnr: f64,
    psnr_colour_corrected: f64,
    ssim: f64,
    noise_sigma: f64,
    sharpness: f64,
    mean_v: f64,
    clipped_share: f64,
}

fn cases() -> Vec<Golden> {
    serde_json::from_str(include_str!("../../../tests/golden/metrics.json"))
        .expect("the stored values")
}

fn hashed(index: usize) -> f64 {
    let mut x = index as u32;
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^= x >> 16;
    f64::from(x) / 4_294_967_296.0
}

fn picture(width: usize, height: usize) -> Image {
    let mut values = Vec::with_capacity(3 * width * height);
    for c in 0..3 {
        for y in 0..height {
            for x in 0..width {
                let (wx, wy) = (0.21 * x as f64 + 0.9 * c as f64, 0.13 * y as f64 - 0.4 * c as f64);
                let waves = 0.45 + 0.25 * wx.sin() * wy.cos();
                values.push((waves + 0.15 * ((x / 9 + y / 7) % 2) as f64) as f32);
            }
        }
    }
    Image::from_planar(width, height, values)
}

fn degraded(image: &Image, [gain, offset, noise]: [f64; 3]) -> Image {
    let values = image.data().iter().enumerate();
    let changed =
        values.map(|(i, &v)| (gain * f64::from(v) + offset + noise * (hashed(i) - 0.5)) as f32);
    Image::from_planar(image.width(), image.height(), changed.collect())
}

/// The first measure that deviates from its golden value by more than the tolerance.
fn disagreement(golden: &Golden, image: &Image, reference: &Image) -> Option<String> {
    let measures = [
        ("psnr", psnr(image, reference), golden.psnr),
        (
            "psnr_colour_corrected",
            psnr_colour_corrected(image, reference),
            golden.psnr_colour_corrected,
        ),
        ("ssim", ssim(image, reference), golden.ssim),
        ("noise_sigma", noise_sigma(image), golden.noise_sigma),
        ("sharpness", sharpness(image), golden.sharpness),
        ("mean_v", mean_v(image), golden.mean_v),
        ("clipped_share", clipped_share(image), golden.clipped_share),
    ];
    let wrong = measures
        .into_iter()
        .find(|(_, ours, theirs)| (ours - theirs).abs() > 1e-6 * theirs.abs().max(1.0));
    wrong.map(|(name, ours, theirs)| format!("{name}: {ours} instead of {theirs}"))
}

#[test]
fn every_metric_matches_scikit_image_and_numpy() {
    let cases = cases();
    assert_eq!(cases.len(), 4);
    for golden in cases {
        let reference = picture(golden.size[0], golden.size[1]);
        let image = degraded(&reference, golden.change);
        assert_eq!(disagreement(&golden, &image, &reference), None, "at {:?}", golden.size);
    }
}

#[test]
fn the_comparison_with_golden_values_can_fail() {
    let golden = cases().swap_remove(0);
    let reference = picture(golden.size[0], golden.size[1]);
    let mut image = degraded(&reference, golden.change);
    image.set(20, 20, [0.0; 3]);
    assert!(disagreement(&golden, &image, &reference).is_some_and(|text| text.starts_with("psnr")));
    let image = degraded(&reference, golden.change);
    let wrong = Golden { ssim: golden.ssim + 1e-5, ..golden };
    assert!(disagreement(&wrong, &image, &reference).is_some_and(|text| text.starts_with("ssim")));
}
