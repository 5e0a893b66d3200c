//! Training on photographs whose noise is known.

use super::*;
use crate::noise_levels::{LEVELS, NoiseLevels};

/// Standard deviation of the noise at a brightness: that of a brightened photograph.
fn deviation(value: f32) -> f32 {
    0.03 / (0.1 + value.max(0.0))
}

/// The views with this noise, known or not.
pub(super) fn noisy(views: &[TrainingView], is_known: bool) -> Vec<TrainingView> {
    let mut random = Random::new(17);
    let mut normal = || (0..12).map(|_| random.signed()).sum::<f64>() as f32 / 2.0;
    let levels = std::array::from_fn(|n| deviation((n as f32 + 0.5) / LEVELS as f32));
    let noisy = |view: &TrainingView| {
        let mut view =
            TrainingView { noise: is_known.then_some(NoiseLevels(levels)), ..view.clone() };
        let values = view.image.data_mut().iter_mut();
        values.for_each(|value| *value += deviation(*value) * normal());
        view
    };
    views.iter().map(noisy).collect()
}

#[test]
fn a_scene_that_expects_the_noise_trains_otherwise_and_as_far() {
    let scene = truth(150, 8);
    let angles: Vec<_> = (0..8).map(|n| -0.6 + 0.17 * f64::from(n)).collect();
    let clean = views_of(&scene, &angles, [96, 64]);
    let held_out = views_of(&scene, &[-0.35, 0.0, 0.33], [96, 64]);
    let config = TrainConfig { resolution_schedule: true, ..config(500, 1_000) };
    let [without, with] = [false, true].map(|is_known| {
        let views = noisy(&clean, is_known);
        let result = trained(&views, start(&views, &scene, &config), &config);
        assert_eq!(result.expected_noise.is_some(), is_known);
        let score = |v: &TrainingView| psnr(&render(&result.gaussians, &v.camera), &v.image);
        held_out.iter().map(score).sum::<f64>() / held_out.len() as f64
    });
    assert!((with - without).abs() > 1e-3, "the noise has no effect: {with:.3} dB");
    assert!(with > 28.0, "{with:.2} dB with the noise, {without:.2} without");
}
