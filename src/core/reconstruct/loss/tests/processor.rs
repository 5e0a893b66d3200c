//! The loss for processors against the reference.

use fled_cpu::loss::{Loss, LossMeans, Shares, Target};

use super::*;

const SHARES: Shares = Shares { absolute: L1_SHARE, similarity: SSIM_SHARE };

/// The target in units of 1/65535.
fn target_values(target: &Image) -> Vec<u16> {
    let words = pack_target(target).into_iter();
    let halves = words.flat_map(|word| [word as u16, (word >> 16) as u16]);
    halves.take(target.data().len()).collect()
}

fn on_processor(prediction: &Image, target: &Image, noise: &Noise) -> (Vec<f32>, LossMeans) {
    let (mut loss, values) = (Loss::default(), target_values(target));
    let against = Target { values: &values, size: [target.width(), target.height()], noise };
    let mut gradient = vec![7.0; prediction.data().len()];
    // Twice: nothing may depend on the leftovers of the last run.
    loss.run(target.data(), against, SHARES, &mut gradient);
    let means = loss.run(prediction.data(), against, SHARES, &mut gradient);
    (gradient, means)
}

#[test]
fn gradient_and_means_match_the_reference_at_odd_sizes() {
    let sizes = [(281, 161), (13, 7), (3, 50), (64, 32), (1, 1)];
    for ((width, height), (noise, by)) in all(&sizes) {
        let (prediction, target) = pictures(width, height);
        let (gradient, found) = on_processor(&prediction, &target, &noise);
        let expected = expected(&prediction, &target, &by);
        assert_agrees(
            &format!("gradient at {width}x{height}"),
            &gradient,
            &expected.gradient,
            1e-3,
        );
        for (ours, theirs) in [
            (found.absolute, expected.l1),
            (found.similarity, expected.ssim),
            (found.squared, expected.squared),
        ] {
            assert!((ours - theirs).abs() < 1e-5, "{width}x{height}: {found:?} {theirs}");
        }
    }
}

#[test]
fn the_masked_loss_matches_the_reference_at_odd_sizes() {
    for ((width, height), (noise, by)) in all(&[(281, 161), (13, 7), (3, 50)]) {
        let (prediction, target) = pictures(width, height);
        let (mask, values) = (mask(width, height), target_values(&target));
        let mut gradient = vec![7.0; prediction.data().len()];
        let against = Target { values: &values, size: [width, height], noise: &noise };
        let found = Loss::default().run_masked(
            prediction.data(),
            against,
            mask.pixels(),
            SHARES,
            &mut gradient,
        );
        let (p, t) = as_f64(&prediction, &target);
        let expected = reference::masked_loss(&p, (&t, mask.pixels()), &by, width);
        let what = format!("gradient at {width}x{height}");
        assert_agrees(&what, &gradient, &expected.gradient, 1e-3);
        let total = L1_SHARE * found.absolute + SSIM_SHARE * (1.0 - found.similarity);
        assert!((total - expected.total()).abs() < 1e-5, "{total} {}", expected.total());
        let outside = gradient.iter().zip(mask.pixels().iter().cycle()).filter(|(_, kept)| !**kept);
        assert!(outside.count() > 0, "nothing is masked");
    }
}

#[test]
fn the_comparison_detects_other_weights() {
    let (prediction, target) = pictures(33, 21);
    for (noise, by) in noises() {
        let (gradient, _) = on_processor(&prediction, &target, &noise);
        let expected = expected(&prediction, &target, &by);
        let wrong: Vec<f64> = expected.gradient.iter().map(|g| g * 0.998).collect();
        assert!(!crate::agreement::agreement(&gradient, &wrong).within(1e-3));
    }
}
