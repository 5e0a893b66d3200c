//! A GPU and the processor train the same scene, but for rounding.

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
fn fifty_steps_agree_with_and_without_shake_masks_and_growth() {
    let scene = truth(150, 8);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [96, 64]);
    let plain = TrainConfig { background: Background::Random, ..config(50, 400) };
    let found = agreement(&views, &scene, &plain);
    assert!(found >= 45.0, "{found:.1} dB");
    let shaken = TrainConfig { shake: Some(Response::srgb()), ..plain.clone() };
    let found = agreement(&views, &scene, &shaken);
    assert!(found >= 45.0, "{found:.1} dB with shake");
    let masked = covered(&views, [1.0, 0.0, 1.0], true);
    let found = agreement(&masked, &scene, &plain);
    assert!(found >= 45.0, "{found:.1} dB with masks");
    let classic = TrainConfig { densify: Densify::Classic, ..plain.clone() };
    let found = agreement(&views, &scene, &classic);
    assert!(found >= 45.0, "{found:.1} dB with classic densification");
    let other = TrainConfig { seed: 4, ..plain };
    let seeds = [&other, &shaken].map(|config| {
        let trained = trained(&views, start(&views, &scene, config), config);
        render(&trained.gaussians, &views[1].camera)
    });
    assert!(psnr(&seeds[0], &seeds[1]) < 45.0, "other trainings must not agree");
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
