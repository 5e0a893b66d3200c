//! A GPU and the processor train the same scene, up to rounding.

use super::*;
use crate::shake::{ShakeKernel, Tap};

/// PSNR between the renders of both devices' scenes after 50 steps.
fn agreement(views: &[TrainingView], scene: &Gaussians, config: &TrainConfig) -> f64 {
    let [first, second] = fixtures::devices().map(|device| {
        let trained = trained_on(&device, views, start(views, scene, config), config);
        render(&trained.gaussians, &views[1].camera)
    });
    psnr(&first, &second)
}

#[test]
fn fifty_steps_agree_with_shake_and_masks_and_with_noise() {
    let scene = truth(150, 8);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [72, 48]);
    let plain = TrainConfig { background: Background::Random, ..config(50, 400) };
    let shaken = TrainConfig { shake: Some(Response::srgb()), ..plain.clone() };
    let found = agreement(&covered(&views, [1.0, 0.0, 1.0], true), &scene, &shaken);
    assert!(found >= 45.0, "{found:.1} dB with shake and masks");
    let found = agreement(&noisy::noisy(&views, true), &scene, &plain);
    assert!(found >= 45.0, "{found:.1} dB with noise that the loss expects");
    let with_field = TrainConfig { noise: NoiseMode::Paper, steps: 20, ..plain.clone() };
    let found = agreement(&views, &scene, &with_field);
    assert!(found >= 45.0, "{found:.1} dB with a noise field");
    let other = TrainConfig { seed: 4, ..plain };
    let seeds = [&other, &shaken].map(|config| {
        let trained = trained(&views, start(&views, &scene, config), config);
        render(&trained.gaussians, &views[1].camera)
    });
    assert!(psnr(&seeds[0], &seeds[1]) < 45.0, "other trainings must not agree");
}

/// Classic densification itself draws from one sequence for all Gaussians: one that is near the
/// threshold on one device shifts the draws of all after it. So its inputs are compared.
#[test]
fn the_statistics_of_classic_densification_agree() {
    let scene = truth(150, 8);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [96, 64]);
    let config = TrainConfig { densify: Densify::Classic, ..config(1_000, 400) };
    let [first, second] = fixtures::devices().map(|device| {
        let begin = start(&views, &scene, &config);
        let trainer = trainer::Trainer::new(&device, &views, begin, &config).expect("made");
        trainer.stopped_at(5, false)[0].state.moments()
    });
    let views_of = |rows: &[optimizer::GeometryMoments]| -> Vec<f32> {
        rows.iter().map(|row| row.gradient_views).collect()
    };
    let differ = views_of(&first).iter().zip(views_of(&second)).filter(|(a, b)| **a != *b).count();
    assert!(differ <= 1 && views_of(&first).contains(&5.0), "{differ} differ");
    let lengths = |rows: &[optimizer::GeometryMoments]| -> Vec<f64> {
        rows.iter().map(|row| f64::from(row.gradient_lengths)).collect()
    };
    let apart = fixtures::relative_l2(&lengths(&first), &lengths(&second));
    assert!(apart < 1e-2, "{apart}");
}

#[test]
fn shaken_renders_agree() {
    let scene = truth(150, 8);
    let camera = camera_at(0.2, 96, 64);
    let kernel = ShakeKernel::new(vec![Tap::even([0, 0], 0.5), Tap::even([4, -2], 0.5)]);
    let response = Response::srgb();
    let [first, second] = fixtures::devices().map(|device| {
        let mut scene = device.scene(&scene).expect("uploaded");
        let sharp = scene.render(&camera, 1).expect("rendered");
        let shaken = Shaken { kernel: &kernel, response: &response };
        let shaken = scene.render_shaken(&camera, 1, shaken).expect("rendered");
        assert!(psnr(&sharp, &shaken) < 30.0);
        shaken
    });
    assert!(psnr(&first, &second) > 60.0);
}

#[test]
fn training_needs_as_much_device_memory_as_reckoned() {
    // A device of its own: the other tests allocate on the common one.
    let gpu = Gpu::new("auto").expect("an adapter");
    let device = Device::Gpu(gpu.clone());
    for (gaussians, size) in [(10_000, [200, 150]), (1_500, [400, 300])] {
        let scene = truth(gaussians / 4, 8);
        let views = views_of(&scene, &[-0.3, 0.0, 0.3], size);
        let shake = Some(Response::srgb());
        let config = TrainConfig { shake, sh_degree: 2, ..config(10, gaussians) };
        let before = gpu.memory().now;
        gpu.forget_peak();
        trained_on(&device, &views, start(&views, &scene, &config), &config);
        let measured = (gpu.memory().peak - before) as f64;
        let pixels = (size[0] * size[1]) as u64;
        let reckoned = device_bytes(gaussians as u64, 2, pixels, 3 * pixels) as f64;
        let ratio = reckoned / measured;
        let shown = format!("{gaussians} of {size:?}: {reckoned} reckoned, {measured} measured");
        eprintln!("{shown}");
        assert!((0.5..2.0).contains(&ratio), "{shown}");
    }
}
