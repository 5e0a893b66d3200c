mod processor;

use reference::ReferenceNoise;

use super::*;
use crate::agreement::assert_agrees;

/// Strong in the dark.
const DEVIATIONS: [f32; LEVELS] = [
    0.3, 0.2, 0.15, 0.11, 0.1, 0.09, 0.08, 0.07, 0.06, 0.05, 0.04, 0.03, 0.02, 0.008, 0.004, 0.002,
];

/// The noise of both forms: none, and some.
fn noises() -> [(Noise, ReferenceNoise); 2] {
    let noise = Noise::new(DEVIATIONS);
    let reference = ReferenceNoise { deviations: DEVIATIONS.map(f64::from) };
    [(Noise::NONE, ReferenceNoise::NONE), (noise, reference)]
}

fn gpu() -> Gpu {
    Gpu::new("auto").expect("the tests need a Vulkan adapter")
}

fn pictures(width: usize, height: usize) -> (Image, Image) {
    let values = |f: f32, g: f32| -> Vec<f32> {
        (0..3 * width * height)
            .map(|i| (i as f32, (i / width) as f32))
            .map(|(x, y)| {
                0.5 + 0.2 * (x * f).sin() + 0.2 * (y * g).cos() + 0.05 * (x * x * f).sin()
            })
            .collect()
    };
    let target = Image::from_planar(width, height, values(0.31, 0.17));
    (Image::from_planar(width, height, values(0.29, 0.19)), target)
}

/// Gradient and value by the kernels.
fn on_device(prediction: &Image, target: &Image, noise: &Noise) -> (Vec<f32>, LossValue) {
    let gpu = gpu();
    let loss = Loss::new(&gpu, target.width(), target.height()).expect("buffers");
    let packed = GpuTarget::upload(&gpu, target, noise).expect("upload");
    let input = gpu.upload("prediction", prediction.data()).expect("upload");
    let gradient = gpu.create::<f32>("gradient", prediction.data().len()).expect("buffer");
    let mut recorder = gpu.recorder();
    loss.record(&mut recorder, &input, &packed, &gradient).expect("recorded");
    recorder.submit().expect("submitted");
    (gradient.read().expect("read"), loss.value().expect("read"))
}

/// The values of a prediction and of the packed target.
fn as_f64(prediction: &Image, target: &Image) -> (Vec<f64>, Vec<f64>) {
    let p: Vec<f64> = prediction.data().iter().map(|&v| f64::from(v)).collect();
    let words = pack_target(target);
    let t = (0..p.len())
        .map(|i| f64::from(words[i / 2] >> (16 * (i % 2)) & 0xffff) / 65535.0)
        .collect();
    (p, t)
}

/// The reference for the packed target.
fn expected(
    prediction: &Image,
    target: &Image,
    noise: &ReferenceNoise,
) -> reference::ReferenceLoss {
    let (p, t) = as_f64(prediction, target);
    reference::loss(&p, &t, noise, target.width())
}

/// These sizes with each noise.
fn all(sizes: &[(usize, usize)]) -> Vec<((usize, usize), (Noise, ReferenceNoise))> {
    sizes.iter().flat_map(|&size| noises().map(|noise| (size, noise))).collect()
}

#[test]
fn the_kernels_match_the_reference_at_odd_sizes() {
    let sizes = [(281, 161), (13, 7), (3, 50)];
    for ((width, height), (noise, by)) in all(&sizes) {
        let (prediction, target) = pictures(width, height);
        let (gradient, value) = on_device(&prediction, &target, &noise);
        let expected = expected(&prediction, &target, &by);
        assert_agrees(
            &format!("gradient at {width}x{height}"),
            &gradient,
            &expected.gradient,
            1e-3,
        );
        for (ours, theirs) in [
            (value.l1, expected.l1),
            (value.ssim, expected.ssim),
            (value.squared, expected.squared),
            (value.total, expected.total()),
        ] {
            assert!(
                (ours - theirs).abs() < 1e-5,
                "{width}x{height}: {value:?}, {}",
                expected.total()
            );
        }
    }
}

/// Includes neither the left quarter nor every seventh pixel.
fn mask(width: usize, height: usize) -> Mask {
    let holds = |i: usize| 4 * (i % width) >= width && !i.is_multiple_of(7);
    Mask::new(width, height, (0..width * height).map(holds).collect())
}

#[test]
fn the_masked_kernels_match_the_reference_at_odd_sizes() {
    for ((width, height), (noise, by)) in all(&[(281, 161), (13, 7), (3, 50)]) {
        let (prediction, target) = pictures(width, height);
        let mask = mask(width, height);
        let gpu = gpu();
        let mut loss = Loss::new(&gpu, width, height).expect("buffers");
        loss.make_masks(&gpu).expect("buffers");
        let packed = GpuTarget::upload(&gpu, &target, &noise).expect("upload");
        let kept = upload_mask(&gpu, &mask).expect("upload");
        let input = gpu.upload("prediction", prediction.data()).expect("upload");
        let gradient = gpu.create::<f32>("gradient", prediction.data().len()).expect("buffer");
        let mut recorder = gpu.recorder();
        let recorded = loss.record_masked(&mut recorder, &input, (&packed, &kept), &gradient);
        recorded.expect("recorded");
        recorder.submit().expect("submitted");
        let (gradient, value) = (gradient.read().expect("read"), loss.value().expect("read"));
        let (p, t) = as_f64(&prediction, &target);
        let expected = reference::masked_loss(&p, (&t, mask.pixels()), &by, width);
        let what = format!("gradient at {width}x{height}");
        assert_agrees(&what, &gradient, &expected.gradient, 1e-3);
        assert!((value.total - expected.total()).abs() < 1e-5, "{value:?}, {}", expected.total());
        assert!((value.squared - expected.squared).abs() < 1e-5, "{value:?}");
        assert_eq!(input.read().expect("read"), prediction.data(), "the render stays as it is");
    }
}

#[test]
fn a_masked_loss_needs_room_and_a_whole_mask() {
    let gpu = gpu();
    let loss = Loss::new(&gpu, 20, 10).expect("buffers");
    let target = GpuTarget::upload(&gpu, &Image::new(20, 10), &Noise::NONE).expect("upload");
    let kept = upload_mask(&gpu, &Mask::full(20, 10)).expect("upload");
    let values = gpu.create("values", 600).expect("buffer");
    let refused = |loss: &Loss, kept: &Buffer<u32>| {
        let mut recorder = gpu.recorder();
        let recorded = loss.record_masked(&mut recorder, &values, (&target, kept), &values);
        matches!(recorded, Err(GpuError::Validation(_)))
    };
    assert!(refused(&loss, &kept));
    let mut loss = loss;
    loss.make_masks(&gpu).expect("buffers");
    let short = upload_mask(&gpu, &Mask::full(20, 5)).expect("upload");
    assert!(refused(&loss, &short));
}

#[test]
fn the_comparison_detects_other_weights() {
    let (prediction, target) = pictures(33, 21);
    for (noise, by) in noises() {
        let (gradient, _) = on_device(&prediction, &target, &noise);
        let expected = expected(&prediction, &target, &by);
        let wrong: Vec<f64> = expected.gradient.iter().map(|g| g * 0.998).collect();
        assert!(!crate::agreement::agreement(&gradient, &wrong).within(1e-3));
    }
}

#[test]
fn the_same_images_give_the_same_bits() {
    let (prediction, target) = pictures(75, 41);
    let run = || on_device(&prediction, &target, &noises()[1].0);
    let (first, second) = (run(), run());
    assert_eq!(first.0, second.0);
    assert_eq!(first.1, second.1);
}

#[test]
fn packing_keeps_sixteen_bits_and_an_odd_last_value() {
    let mut image = Image::new(1, 1);
    image.set(0, 0, [1.0, 0.5, -3.0]);
    assert_eq!(pack_target(&image), [0xffff | (32768 << 16), 0]);
}

#[test]
fn a_short_buffer_is_refused() {
    let gpu = gpu();
    let loss = Loss::new(&gpu, 20, 10).expect("buffers");
    let target = GpuTarget::upload(&gpu, &Image::new(20, 10), &Noise::NONE).expect("upload");
    let (long, short) =
        (gpu.create("long", 600).expect("buffer"), gpu.create("short", 599).expect("buffer"));
    let mut recorder = gpu.recorder();
    assert!(matches!(
        loss.record(&mut recorder, &short, &target, &long),
        Err(GpuError::Validation(_))
    ));
}

#[test]
fn uniform_and_columns_match_the_shaders() {
    let (_, found) = SIMILARITY.reflect().expect("the row agrees with the shader");
    let (_, gradient) = GRADIENT.reflect().expect("the row agrees with the shader");
    let layout = found.structure("LossUniform").expect("declared");
    assert_eq!(layout.size as usize, size_of::<LossUniform>());
    let offset = |name: &str| {
        let member = layout.members.iter().find(|(other, _)| other == name);
        member.unwrap_or_else(|| panic!("no {name}")).1 as usize
    };
    assert_eq!(offset("run"), std::mem::offset_of!(LossUniform, run));
    assert_eq!(offset("l1_weight"), std::mem::offset_of!(LossUniform, l1_weight));
    assert_eq!(offset("values"), std::mem::offset_of!(LossUniform, values));
    assert_eq!(gradient.structure("LossUniform"), Some(layout));
    assert_eq!(found.constant("COLUMNS"), Some(f64::from(COLUMNS)));
    let layout = found.structure("NoiseUniform").expect("declared");
    assert_eq!(layout.size as usize, size_of::<NoiseUniform>());
    let first = layout.members.iter().find(|(name, _)| name == "first").expect("declared");
    assert_eq!(first.1 as usize, std::mem::offset_of!(NoiseUniform, first));
    assert_eq!(found.constant("LEVELS"), Some(LEVELS as f64));
}
