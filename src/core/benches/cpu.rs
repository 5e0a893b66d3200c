//! Benchmarks of the host's work between the kernels: `cargo bench -p fled-core`.
//!
//! Images are synthetic, reproducible, and of the size of the preset `standard`.

use std::f32::consts::TAU;

use divan::{Bencher, black_box, counter::BytesCount, counter::ItemsCount};
use fled_core::camera::normalisation::Normalisation;
use fled_core::enhance::{Anchor, Histogram, ToneCurve, match_anchor};
use fled_core::gaussians::{Gaussians, ply};
use fled_core::image::Image;
use fled_core::metrics;
use fled_core::shake::{self, Response};

const WIDTH: usize = 560;
const HEIGHT: usize = 320;
const PIXELS: usize = WIDTH * HEIGHT;

fn main() {
    divan::main();
}

/// Waves of many lengths and some grain, between 0 and `brightest`.
fn image(brightest: f32) -> Image {
    let mut image = Image::new(WIDTH, HEIGHT);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let (u, v) = (x as f32 / WIDTH as f32, y as f32 / HEIGHT as f32);
            let wave = |k: f32| (TAU * k * u).sin() * (TAU * k * v).cos() / k.sqrt();
            let grain = ((x * 7919 + y * 104_729) % 97) as f32 / 97.0;
            let level = 0.5 + 0.12 * (wave(2.0) + wave(7.0) + wave(31.0)) + 0.05 * grain;
            image.set(
                x,
                y,
                [level, 0.9 * level, 0.7 * level + 0.1 * u].map(|c| c * brightest),
            );
        }
    }
    image
}

/// The mean of the image and two copies shifted by 1 and 2.3 px.
fn shaken(sharp: &Image) -> Image {
    let mut shaken = Image::new(WIDTH, HEIGHT);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let sum = [0.0, 1.0, 2.3].map(|by| sharp.sample(x as f32 + 0.5 + by, y as f32 + 0.5));
            shaken.set(
                x,
                y,
                [0, 1, 2].map(|c| (sum[0][c] + sum[1][c] + sum[2][c]) / 3.0),
            );
        }
    }
    shaken
}

fn scene(count: usize) -> Gaussians {
    let at = |i: usize| (i as f32 * 0.618).fract();
    Gaussians {
        means: (0..count).map(|i| [at(i), at(3 * i), at(7 * i)]).collect(),
        quats: vec![[1.0, 0.1, 0.2, 0.3]; count],
        log_scales: vec![[-3.0, -4.0, -5.0]; count],
        opacity_logits: (0..count).map(at).collect(),
        sh: (0..count * 27).map(at).collect(),
        sh_degree: 2,
    }
}

#[divan::bench]
fn tone_curve_from_a_histogram(bencher: Bencher<'_, '_>) {
    let histogram = Histogram::of(&image(0.2));
    bencher.bench(|| {
        ToneCurve::new(
            black_box(&histogram),
            Anchor::Equalised {
                alpha: 10.0,
                gamma: 0.8,
            },
        )
    });
}

#[divan::bench]
fn tone_curve_over_an_image(bencher: Bencher<'_, '_>) {
    let dark = image(0.2);
    let curve = ToneCurve::new(&Histogram::of(&dark), Anchor::exposure(3.5));
    bencher
        .counter(ItemsCount::new(PIXELS))
        .bench(|| curve.apply(black_box(&dark)));
}

#[divan::bench]
fn ssim(bencher: Bencher<'_, '_>) {
    let (a, b) = (image(1.0), image(0.9));
    bencher
        .counter(ItemsCount::new(PIXELS))
        .bench(|| metrics::ssim(black_box(&a), black_box(&b)));
}

#[divan::bench]
fn psnr(bencher: Bencher<'_, '_>) {
    let (a, b) = (image(1.0), image(0.9));
    bencher
        .counter(ItemsCount::new(PIXELS))
        .bench(|| metrics::psnr(black_box(&a), black_box(&b)));
}

#[divan::bench]
fn psnr_after_a_colour_fit(bencher: Bencher<'_, '_>) {
    let (a, b) = (image(1.0), image(0.9));
    let measured = || metrics::psnr_colour_corrected(black_box(&a), black_box(&b));
    bencher.counter(ItemsCount::new(PIXELS)).bench(measured);
}

#[divan::bench(sample_count = 5)]
fn match_by_differential_evolution(bencher: Bencher<'_, '_>) {
    let (render, target) = (image(0.3), image(0.8));
    let histogram = Histogram::of(&render);
    bencher.bench(|| match_anchor(&[(&render, &target)], &histogram, Anchor::exposure(0.0), 0));
}

#[divan::bench(sample_count = 10)]
fn shake_of_one_view(bencher: Bencher<'_, '_>) {
    let sharp = image(0.8);
    let photograph = shaken(&sharp);
    let response = Response::srgb();
    bencher.bench(|| shake::estimate(black_box(&sharp), black_box(&photograph), &response));
}

#[divan::bench(args = [10_000, 200_000])]
fn ply_write(bencher: Bencher<'_, '_>, count: usize) {
    let scene = scene(count);
    let mut bytes = Vec::new();
    ply::write_to(&scene, &Normalisation::default(), &mut bytes).expect("memory takes it");
    bencher
        .counter(BytesCount::new(bytes.len()))
        .bench_local(|| {
            bytes.clear();
            ply::write_to(black_box(&scene), &Normalisation::default(), &mut bytes)
                .expect("memory takes it");
        });
}

#[divan::bench(args = [10_000, 200_000])]
fn ply_read(bencher: Bencher<'_, '_>, count: usize) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("scene.ply");
    ply::write(&scene(count), &Normalisation::default(), &path).expect("written");
    let bytes = std::fs::metadata(&path).expect("there").len();
    bencher
        .counter(BytesCount::new(bytes))
        .bench(|| ply::read(black_box(&path)).expect("read"));
}
