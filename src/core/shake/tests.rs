mod processor;

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::reference::ReferenceShake;
use super::*;
use crate::agreement::{agreement, assert_agrees, assert_derivative};
use crate::image::Image;
use crate::random::normal;

/// An S of 15 taps with one heavier tap, so that it has no symmetry.
fn curve() -> ShakeKernel {
    let tap = |n: i32| {
        let along = f64::from(n) / 7.0;
        let offset = [(5.0 * along).round() as i32, (2.0 * (3.0 * along).sin()).round() as i32];
        Tap::even(offset, if n == 3 { 2.0 } else { 1.0 })
    };
    let mut taps: Vec<Tap> = (-7..=7).map(tap).collect();
    taps.dedup_by_key(|tap| tap.offset);
    ShakeKernel::new(taps)
}

/// The shake of a camera that moves and rotates about its line of sight: a line in each cell.
fn turn() -> ShakeKernel {
    let line = |cell: usize| {
        let (x, y) = ((cell % ALONG) as f64 - 1.0, (cell / ALONG) as f64 - 0.5);
        (-8..=8).map(move |n| {
            let along = f64::from(n) / 2.0;
            (cell, [along * (1.0 - 0.6 * y), along * 0.8 * x].map(|o| o.round() as i32))
        })
    };
    let mut taps = BTreeMap::new();
    for (cell, offset) in (0..CELLS).flat_map(line) {
        taps.entry(offset).or_insert(Tap::even(offset, 0.0)).weights[cell] += 1.0;
    }
    ShakeKernel::new(taps.into_values().collect())
}

/// A curve like those of equalisation: steep in the dark, nearly flat above.
fn response() -> Response {
    Response::through(|v| if v < 0.25 { 3.2 * v } else { 0.8 + 0.2 * (v - 0.25) / 0.75 })
}

/// Blocks and waves: edges in all directions.
fn picture(width: usize, height: usize) -> Image {
    let value = |x: usize, y: usize, c: usize| {
        let block = (x / 7 * 31 + y / 5 * 17 + c * 7) % 11;
        let wave = (0.41 * x as f32 + 0.23 * y as f32).sin() * (0.17 * y as f32).cos();
        0.08 + 0.06 * block as f32 + 0.08 * (1.0 + wave)
    };
    let planes =
        (0..3).flat_map(|c| (0..height).flat_map(move |y| (0..width).map(move |x| value(x, y, c))));
    Image::from_planar(width, height, planes.collect())
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

fn shaken(image: &Image, kernel: &ShakeKernel, response: &Response) -> Image {
    let size = [image.width(), image.height()];
    let values = ReferenceShake { size, kernel, response }.shaken(&wide(image.data()));
    Image::from_planar(size[0], size[1], values.into_iter().map(|v| v as f32).collect())
}

/// The shaken image and the gradient, each by the device and by the reference.
fn compare(
    kernel: &ShakeKernel,
    response: &Response,
    size: [usize; 2],
) -> [(Vec<f32>, Vec<f64>); 2] {
    let gpu = Gpu::new("auto").expect("the tests need a Vulkan adapter");
    let render = picture(size[0], size[1]);
    let upstream: Vec<f32> =
        (0..render.data().len()).map(|i| (0.37 * i as f32).sin() * 1e-3).collect();
    let shake = Shake::new(&gpu, [64, 64], response).expect("buffers");
    let mut view = DeviceKernel::new(&gpu).expect("buffers");
    shake.set(&mut view, size, kernel.clone()).expect("fits");
    let on_device = |values: &[f32]| gpu.upload("image", values).expect("uploaded");
    let (image, gradient) = (on_device(render.data()), on_device(&upstream));
    let mut recorder = gpu.recorder();
    shake.record_forward(&mut recorder, &view, &image).expect("recorded");
    shake.record_backward(&mut recorder, &view, &image, &gradient).expect("recorded");
    recorder.submit().expect("submitted");
    let read = |buffer: &Buffer<f32>| buffer.read().expect("read")[..upstream.len()].to_vec();
    let reference = ReferenceShake { size, kernel, response };
    let values = wide(render.data());
    [
        (read(shake.blurred()), reference.shaken(&values)),
        (read(shake.render_gradient()), reference.gradient(&values, &wide(&upstream))),
    ]
}

#[test]
fn image_and_gradient_match_the_reference() {
    let cases = [
        (curve(), response(), [61, 43]),
        (ShakeKernel::still(), Response::srgb(), [61, 43]),
        (turn(), response(), [61, 43]),
        (turn(), response(), [43, 61]),
    ];
    for (kernel, response, size) in cases {
        let [image, gradient] = compare(&kernel, &response, size);
        assert_agrees("image", &image.0, &image.1, 1e-5);
        assert_agrees("gradient", &gradient.0, &gradient.1, 1e-4);
    }
}

#[test]
fn the_comparison_detects_a_mirrored_kernel() {
    let mirrored = |tap: &Tap| Tap { offset: tap.offset.map(|o| -o), ..*tap };
    let other = ShakeKernel::new(curve().taps().iter().map(mirrored).collect());
    let ([image, gradient], [wrong, wrong_gradient]) =
        (compare(&curve(), &response(), [61, 43]), compare(&other, &response(), [61, 43]));
    assert!(!agreement(&image.0, &wrong.1).within(1e-3));
    assert!(!agreement(&gradient.0, &wrong_gradient.1).within(1e-2));
}

#[test]
fn the_reference_gradient_matches_central_differences() {
    let (kernel, response, size) = (turn(), response(), [17, 9]);
    let reference = ReferenceShake { size, kernel: &kernel, response: &response };
    // Between the knots of the response, which have no derivative.
    let render: Vec<f64> =
        wide(picture(17, 9).data()).iter().map(|v| (v * 255.0).floor() / 255.0 + 0.002).collect();
    let upstream: Vec<f64> = (0..render.len()).map(|i| (0.7 * i as f64).cos()).collect();
    let gradient = reference.gradient(&render, &upstream);
    for at in [0, 16, 60, 153 + 77, 306 + 152] {
        assert_derivative(&format!("value {at}"), gradient[at], render[at], |value| {
            let mut moved = render.clone();
            moved[at] = value;
            let shaken = reference.shaken(&moved);
            shaken.iter().zip(&upstream).map(|(s, u)| s * u).sum::<f64>()
                + reference.roughness(&moved)
        });
    }
}

#[test]
fn a_still_kernel_changes_nothing_and_light_is_preserved() {
    let image = picture(40, 30);
    let same = shaken(&image, &ShakeKernel::still(), &response());
    assert!(image.data().iter().zip(same.data()).all(|(a, b)| (a - b).abs() < 1e-5));
    let flat = Image::from_planar(40, 30, vec![0.4; 3600]);
    assert!(shaken(&flat, &curve(), &response()).data().iter().all(|v| (v - 0.4).abs() < 1e-5));
}

#[test]
fn the_response_is_strictly_increasing_and_invertible() {
    for response in [Response::srgb(), response(), Response::through(|v| (v * 1.7).min(1.0))] {
        let knots = response.knots();
        assert!(knots.windows(2).all(|pair| pair[0] < pair[1] && pair[1].is_finite()));
        for value in [0.0, 0.003, 0.2, 0.55, 0.999, 1.0, 1.3] {
            assert!((response.value(response.light(value)) - value).abs() < 1e-6, "{value}");
        }
    }
}

#[test]
fn the_shake_is_recovered_from_a_noisy_photograph() {
    let (sharp, response) = (picture(280, 160), Response::srgb());
    let noisy = |image: &Image| {
        let noise =
            |i: usize| (0.02 * (12.9898 * i as f64).sin() * (78.233 * i as f64).cos()) as f32;
        let data = image.data().iter().enumerate().map(|(i, v)| v + noise(i)).collect();
        Image::from_planar(image.width(), image.height(), data)
    };
    let kernel = curve();
    let photograph = noisy(&shaken(&sharp, &kernel, &response));
    for estimate in [estimate, estimate_by_cells] {
        let found = estimate(&sharp, &photograph, &response, None);
        // Far taps have a price, so an estimate is slightly too narrow, and never too wide.
        let wide = found.spread() / kernel.spread();
        assert!((0.85..1.02).contains(&wide), "{wide} of the true spread");
        assert!(found.centroid().iter().all(|c| c.abs() < 0.3), "{:?}", found.centroid());
        let weight = |of: &ShakeKernel, offset| {
            of.taps().iter().find(|t| t.offset == offset).map_or(0.0, Tap::weight)
        };
        let apart: f32 =
            kernel.taps().iter().map(|t| (weight(&found, t.offset) - t.weight()).abs()).sum();
        assert!(apart < 1.0, "{apart} of 2 apart: {found:?}");
        let still = estimate(&sharp, &noisy(&sharp), &response, None);
        assert!(still.spread() < 0.3, "a still photograph: {still:?}");
    }
}

#[test]
fn a_camera_rotation_needs_a_kernel_for_each_cell() {
    for (width, height) in [(280, 180), (180, 280)] {
        let (sharp, response) = (picture(width, height), Response::srgb());
        let right = shaken(&sharp, &turn(), &response);
        let mut photograph = right.clone();
        let mut random = Pcg64Mcg::seed_from_u64(9);
        photograph.data_mut().iter_mut().for_each(|v| *v += (0.03 * normal(&mut random)) as f32);
        let left = |kernel: &ShakeKernel| {
            difference(&shaken(&sharp, kernel, &response), &right, |_, _| true)
        };
        let one = left(&estimate(&sharp, &photograph, &response, None));
        let cells = left(&estimate_by_cells(&sharp, &photograph, &response, None));
        assert!(cells < 0.6 * one, "{cells:.4} with cells, {one:.4} without");
    }
}

#[test]
fn the_shake_of_a_large_photograph_is_found_at_half_its_size() {
    let sharp = picture(400, 300).resize_bilinear(800, 600);
    let (kernel, response) = (curve().doubled(), Response::srgb());
    let mut photograph = shaken(&sharp, &kernel, &response);
    let mut random = Pcg64Mcg::seed_from_u64(3);
    photograph.data_mut().iter_mut().for_each(|v| *v += (0.03 * normal(&mut random)) as f32);
    let found = estimate(&sharp, &photograph, &response, None);
    let right = shaken(&sharp, &kernel, &response);
    let apart = |image: &Image| difference(image, &right, |_, _| true);
    let (left, still) = (apart(&shaken(&sharp, &found, &response)), apart(&sharp));
    assert!(left < 0.15 * still, "{left:.4} of {still:.4}");
}

#[test]
fn a_halved_kernel_shakes_a_halved_image_alike() {
    let (sharp, response) =
        (picture(160, 120).resize_area(80, 60).resize_bilinear(160, 120), Response::srgb());
    let halved = |image: &Image| image.resize_area(80, 60);
    let right = halved(&shaken(&sharp, &curve(), &response));
    let apart = |image: &Image| {
        let pairs = image.data().iter().zip(right.data());
        pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / right.data().len() as f64
    };
    let found = apart(&shaken(&halved(&sharp), &curve().halved(), &response));
    let unshaken = apart(&halved(&sharp));
    assert!(found < 0.1 * unshaken, "{found} apart, {unshaken} without a kernel");
}

#[test]
fn a_smaller_image_is_shaken_by_fewer_pixels() {
    // The variance along the path is 2 px^2, across it 0.
    let taps = [-2, 0, 2].map(|x| Tap::even([x, 0], if x == 0 { 2.0 } else { 1.0 }));
    let kernel = ShakeKernel::new(taps.to_vec());
    let least = [280, 420, 560].map(|side| kernel.elongation() / kernel.significance(side));
    assert!((kernel.elongation() - 2_f64.sqrt()).abs() < 1e-6);
    assert!((0.98..1.26).contains(&least[0]), "fox, and the room of `fled synth`");
    assert!((0.91..1.45).contains(&least[1]), "still and shaken cells");
    assert!((1.33..1.66).contains(&least[2]), "still cells, and most shaken ones");
}

#[test]
fn uninformative_images_have_no_shake() {
    let flat = Image::from_planar(100, 80, vec![0.3; 24_000]);
    assert_eq!(estimate(&flat, &flat, &Response::srgb(), None), ShakeKernel::still());
    let small = picture(9, 9);
    assert_eq!(estimate(&small, &small, &Response::srgb(), None), ShakeKernel::still());
    let mut broken = picture(100, 80);
    broken.data_mut()[500] = f32::NAN;
    assert_eq!(estimate(&broken, &picture(100, 80), &Response::srgb(), None), ShakeKernel::still());
    let bad = [f32::NAN, -1.0, 0.0, f32::INFINITY].map(|weight| Tap::even([1, 1], weight));
    assert_eq!(ShakeKernel::new(bad.to_vec()), ShakeKernel::still());
}

#[test]
fn saved_kernels_round_trip_and_invalid_ones_are_refused() {
    let kernels = vec![ShakeKernel::still(), curve(), turn()];
    let state = save(&kernels);
    assert_eq!(parse(&state, 3), Some(kernels));
    assert_eq!(parse(&state[..state.len() - 1], 3), None);
    assert_eq!(parse(&state, 1), None);
    assert_eq!(parse(&[1e9, 0.0], 1), None);
}

#[test]
fn an_image_larger_than_the_buffers_is_refused() {
    let gpu = Gpu::new("auto").expect("the tests need a Vulkan adapter");
    let shake = Shake::new(&gpu, [20, 10], &Response::srgb()).expect("buffers");
    let mut view = DeviceKernel::new(&gpu).expect("buffers");
    assert!(shake.set(&mut view, [20, 10], curve()).is_ok());
    assert!(shake.set(&mut view, [30, 10], curve()).is_err());
}

#[test]
fn struct_and_constants_match_the_shaders() {
    let table = [&kernels::LINEARISE, &kernels::BLUR, &kernels::SCALE, &kernels::BLUR_BACKWARD];
    for kernel in table {
        let (text, found) = kernel.reflect().expect("valid");
        let layout = found.structure("ShakeUniform").expect("declared");
        assert_eq!(layout.size as usize, size_of::<ShakeUniform>());
        let offsets: Vec<_> = layout.members.iter().map(|m| m.1 as usize).collect();
        assert_eq!(offsets, (0..4).map(|i| 4 * i).collect::<Vec<_>>());
        assert!(text.contains(&format!("const KNOTS: u32 = {}u;", response::KNOTS)));
    }
    assert_eq!(std::mem::offset_of!(ShakeUniform, smooth_weight), 12);
    let (text, _) = kernels::BLUR_BACKWARD.reflect().expect("valid");
    assert!(text.contains(&format!("const BEND: f32 = {SMOOTH_BEND:?};")));
}

/// Root mean square difference of the pixels whose position meets the condition.
fn difference(one: &Image, other: &Image, is_meant: impl Fn(usize, usize) -> bool) -> f64 {
    let (width, pixels) = (one.width(), one.pixels());
    let is_meant = |at: usize| is_meant(at % pixels % width, at % pixels / width);
    let squares: Vec<f64> = { one.data().iter().zip(other.data()).enumerate() }
        .filter(|(at, _)| is_meant(*at))
        .map(|(_, (one, other))| f64::from((one - other).powi(2)))
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn denoising_keeps_shake_and_parts_that_deblurring_got_wrong() {
    const NOISE: f64 = 0.05;
    let (sharp, response) = (picture(240, 180), Response::srgb());
    let blurred = shaken(&sharp, &curve(), &response);
    let mut photograph = blurred.clone();
    let mut random = Pcg64Mcg::seed_from_u64(7);
    photograph.data_mut().iter_mut().for_each(|v| *v += (NOISE * normal(&mut random)) as f32);
    let (clean, noise) = denoised(&photograph, &sharp, &response);
    let everywhere = |_, _| true;
    let left = difference(&clean, &blurred, everywhere);
    assert!(left < 0.75 * NOISE, "{left:.4}");
    let share = f64::from(noise.at(0.5)) / NOISE;
    assert!((share - (0.035 / NOISE).powi(2)).abs() < 0.1, "{share:.2} of the noise is left");
    let shake = difference(&sharp, &blurred, everywhere);
    assert!(left < 0.5 * shake, "{left:.4} of {shake:.4}: it is not sharpened");
    let mut wrong = sharp;
    let is_wrong = |x: usize, y: usize| (80..140).contains(&x) && (60..120).contains(&y);
    for (x, y) in (0..240 * 180).map(|at| (at % 240, at / 240)).filter(|&(x, y)| is_wrong(x, y)) {
        wrong.set(x, y, [0.9; 3]);
    }
    let kept = difference(&denoised(&photograph, &wrong, &response).0, &blurred, is_wrong);
    assert!(kept < 1.3 * NOISE, "{kept:.4}");
}

#[test]
fn masked_pixels_do_not_affect_the_shake() {
    let response = Response::srgb();
    let sharp = picture(160, 120);
    let taps = (-3..=3).map(|x| Tap::even([x, 0], 1.0)).collect();
    let mut photograph = shaken_image(&sharp, &ShakeKernel::new(taps), &response);
    // A still hand with strong edges covers a third.
    let is_hand = |i: usize| i % 160 < 53;
    for i in (0..160 * 120).filter(|&i| is_hand(i)) {
        let stripe = if (i % 160 / 3 + i / 160 / 4).is_multiple_of(2) { 0.95 } else { 0.02 };
        photograph.set(i % 160, i / 160, [stripe; 3]);
    }
    let kept = (0..160 * 120).map(|i| !is_hand(i)).collect();
    let kept = crate::mask::Mask::new(160, 120, kept);
    let found = estimate(&sharp, &photograph, &response, Some(&kept)).elongation();
    let misled = estimate(&sharp, &photograph, &response, None).elongation();
    assert!((found - 2.0).abs() < 0.4, "{found} px, {misled} px with the hand");
    assert!((misled - 2.0).abs() > (found - 2.0).abs(), "{found} px, {misled} px with the hand");
}
