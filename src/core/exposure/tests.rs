use super::*;

fn ratio(first: usize, second: usize, stops: f64) -> Ratio {
    Ratio { views: [first, second], stops: [stops, stops + 0.1, stops - 0.1], pixels: 500 }
}

/// Different gains for `count` views, with a mean of zero.
fn truth(count: usize) -> Vec<Gains> {
    let stops = |view: usize| {
        let at = view as f64;
        [(1.7 * at).sin(), (1.7 * at).sin() + 0.1 * at.cos(), 0.8 * (2.3 * at).cos()]
    };
    let mut all: Vec<[f64; 3]> = (0..count).map(stops).collect();
    for channel in 0..3 {
        let mean = all.iter().map(|stops| stops[channel]).sum::<f64>() / count as f64;
        all.iter_mut().for_each(|stops| stops[channel] -= mean);
    }
    all.into_iter().map(|stops| Gains { stops }).collect()
}

fn between(gains: &[Gains], first: usize, second: usize) -> Ratio {
    let stops = std::array::from_fn(|c| gains[first].stops[c] - gains[second].stops[c]);
    Ratio { views: [first, second], stops, pixels: 2_000 }
}

#[test]
fn gains_fit_the_pairs_despite_outliers() {
    let gains = truth(12);
    let mut ratios: Vec<Ratio> = (0..12)
        .flat_map(|first| (1..4).map(move |step| (first, (first + step) % 12)))
        .map(|(first, second)| between(&gains, first, second))
        .collect();
    for wrong in [3, 17, 30] {
        ratios[wrong].stops.iter_mut().for_each(|stops| *stops += 1.5);
    }
    let found = solve(&[None; 12], &ratios, &[0.0; 12]);
    for (found, wanted) in found.gains.iter().zip(&gains) {
        for channel in 0..3 {
            let apart = (found.stops[channel] - wanted.stops[channel]).abs();
            assert!(apart < 0.06, "{found:?} {wanted:?}");
        }
    }
    assert!(found.residual.expect("pairs") < 0.06, "{found:?}");
}

#[test]
fn the_prior_decides_only_without_pairs() {
    let gains = truth(4);
    let ratios = [between(&gains, 0, 1), between(&gains, 1, 2), between(&gains, 0, 2)];
    let found = solve(&[None; 4], &ratios, &[0.0, 0.0, 0.0, 1.0]);
    let apart = |a: usize, b: usize| found.gains[a].stops[1] - found.gains[b].stops[1];
    let wanted = gains[0].stops[1] - gains[1].stops[1];
    assert!((apart(0, 1) - wanted).abs() < 0.02 * wanted.abs() + 0.01);
    let others = (0..3).map(|view| found.gains[view].stops[1]).sum::<f64>() / 3.0;
    assert!((found.gains[3].stops[1] - others - 1.0).abs() < 0.05, "{found:?}");
}

#[test]
fn known_gains_stay_and_decide_the_others() {
    let gains = truth(3);
    let ratios = [between(&gains, 2, 0), between(&gains, 1, 2)];
    let known = [Some(gains[0]), Some(gains[1]), None];
    let found = solve(&known, &ratios, &[0.0; 3]);
    assert_eq!(found.gains[..2], gains[..2]);
    let apart = |c: usize| (found.gains[2].stops[c] - gains[2].stops[c]).abs();
    assert!((0..3).all(|c| apart(c) < 0.02), "{found:?}");
}

#[test]
fn pairs_that_agree_on_no_gain_leave_a_residual() {
    let contradictory = [ratio(0, 1, 0.5), ratio(1, 2, 0.5), ratio(2, 0, 0.5)];
    assert!(solve(&[None; 3], &contradictory, &[0.0; 3]).residual.expect("pairs") > 0.3);
    assert_eq!(solve(&[None; 3], &[], &[0.0; 3]).residual, None);
}

#[test]
fn evening_undoes_the_exposure() {
    let values = (0..3 * 12 * 8).map(|i| 0.05 + 0.6 * (i % 90) as f32 / 90.0).collect();
    let neutral = Image::from_planar(12, 8, values);
    let gains = Gains { stops: [0.8, 0.6, -0.4] };
    let photograph = gains.expose(&neutral);
    let back = gains.even(&photograph);
    let apart = back.data().iter().zip(neutral.data()).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) < 1e-5);
    assert_eq!(Gains::default().even(&photograph), photograph);
    assert!((gains.exposure() - 1.0 / 3.0).abs() < 1e-12);
    assert_eq!(gains.tint().map(|stops| (10.0 * stops).round()), [2.0, -10.0]);
}

#[test]
fn gains_are_an_exposure_and_a_tint_and_come_back_from_them() {
    let gains = Gains { stops: [0.5, -0.25, 0.1] };
    let back = Gains::of(gains.exposure(), gains.tint());
    for (back, stops) in back.stops.into_iter().zip(gains.stops) {
        assert!((back - stops).abs() < 1e-12, "{back} {stops}");
    }
}
