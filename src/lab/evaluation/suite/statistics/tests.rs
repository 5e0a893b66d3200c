use super::*;
use crate::evaluation::suite::tests::made_up::{run, view};

#[test]
fn captures_count_equally_whatever_their_views_and_seeds() {
    let runs = [
        run("fox", "plain", 0, &[("a", 20.0), ("b", 21.0)]),
        run("fox", "plain", 1, &[("a", 20.0)]),
        run("hare", "plain", 0, &[("a", 10.0)]),
        run("fox", "fled", 0, &[("a", 21.0), ("b", 22.0)]),
        run("fox", "fled", 1, &[("a", 21.0)]),
        run("hare", "fled", 0, &[("a", 13.0)]),
    ];
    let found = difference(&runs, ("fled", "plain"), Measure::PsnrCc, Cameras::Registered);
    let found = found.expect("pairs");
    assert_eq!(found.mean, 2.0);
    let pairs: Vec<_> = found.captures.iter().map(|c| (c.mean, c.pairs, c.seeds)).collect();
    assert_eq!(pairs, [(1.0, 3, 2), (3.0, 1, 1)]);
    assert_eq!(found.interval, Some([1.0, 3.0]));
    assert!(!found.can_be_claimed());
}

#[test]
fn only_the_same_capture_seed_and_view_form_a_pair() {
    let runs = [
        run("fox", "plain", 0, &[("a", 20.0), ("b", 1.0)]),
        run("fox", "plain", 1, &[("a", 2.0)]),
        run("hare", "plain", 0, &[("a", 3.0)]),
        run("fox", "fled", 0, &[("a", 21.0), ("c", 99.0)]),
        run("fox", "fled", 2, &[("a", 98.0)]),
    ];
    let of = |pair| difference(&runs, pair, Measure::PsnrCc, Cameras::Registered);
    let found = of(("fled", "plain")).expect("a pair");
    assert_eq!((found.mean, found.captures.len()), (1.0, 1));
    assert_eq!(found.interval, None, "one capture has no spread");
    assert_eq!(of(("fled", "other")), None);
}

#[test]
fn every_measure_and_camera_reads_its_own_score() {
    let mut scores = view("a", 20.0).registered;
    scores.all.ssim = 0.5;
    scores.all.psnr_fine_db = 30.0;
    assert_eq!(Measure::PsnrCc.of(&scores), Some(20.0));
    assert_eq!(Measure::Ssim.of(&scores), Some(0.5));
    assert_eq!(Measure::Fine.of(&scores), Some(30.0));
    assert_eq!(Measure::Lpips.of(&scores), None);
    scores.all.lpips_squeeze = Some(0.1);
    assert_eq!(Measure::Lpips.of(&scores), Some(0.1));
    assert_eq!(Measure::PsnrCcSeen.of(&scores), Some(21.0));
    scores.seen = None;
    assert_eq!(Measure::PsnrCcSeen.of(&scores), None);
    // The mapped scores of a synthetic view are 5 dB lower.
    assert_eq!(Cameras::Mapped.of(&view("a", 20.0)).all.psnr_cc_db, 15.0);
}

/// The values are 1 to 10: the resamples' means have mean 5.5 and the standard error of the values
/// themselves, 2.8723 / sqrt(10), and 95 % of them lie within 1.96 standard errors of it.
#[test]
fn the_interval_is_that_of_the_mean() {
    let values: Vec<f64> = (1..=10).map(f64::from).collect();
    let [low, high] = interval(&values).expect("ten values");
    assert!((low - 3.72).abs() < 0.12, "{low}");
    assert!((high - 7.28).abs() < 0.12, "{high}");
    assert_eq!(interval(&values), Some([low, high]), "always the same");
    assert_eq!(interval(&[2.0; 6]), Some([2.0, 2.0]));
}

#[test]
fn percentiles_interpolate_between_neighbours() {
    assert_eq!(percentile(&[1.0, 2.0, 4.0], 0.5), 2.0);
    assert_eq!(percentile(&[1.0, 2.0, 4.0], 0.75), 3.0);
    assert_eq!(percentile(&[1.0, 2.0, 4.0], 1.0), 4.0);
}

#[test]
fn a_claim_needs_six_captures_and_two_seeds_on_each() {
    let claims = |captures: usize, seeds: u64| {
        let mut runs = Vec::new();
        for capture in 0..captures {
            // With three seeds, the last capture has only one.
            let less = u64::from(capture + 1 == captures && seeds == 3) * 2;
            for seed in 0..seeds - less {
                for (name, psnr) in [("plain", 20.0), ("fled", 21.0)] {
                    runs.push(run(&capture.to_string(), name, seed, &[("a", psnr)]));
                }
            }
        }
        difference(&runs, ("fled", "plain"), Measure::PsnrCc, Cameras::Registered)
            .expect("pairs")
            .can_be_claimed()
    };
    assert!(claims(6, 2));
    assert!(!claims(5, 2));
    assert!(!claims(6, 1));
    assert!(!claims(6, 3), "one capture has a single seed");
}

#[test]
fn a_share_counts_if_the_ceiling_is_a_decibel_away() {
    let mut runs = Vec::new();
    for (capture, [plain, fled, sharp]) in
        [("fox", [20.0, 21.0, 24.0]), ("hare", [20.0, 21.0, 22.0]), ("owl", [20.0, 20.5, 20.9])]
    {
        for (name, psnr) in [("plain", plain), ("fled", fled), ("sharp", sharp)] {
            runs.push(run(capture, name, 0, &[("a", psnr)]));
        }
    }
    let over = |name| {
        let found = difference(&runs, (name, "plain"), Measure::PsnrCc, Cameras::Registered);
        found.expect("pairs")
    };
    let found = reached(&over("fled"), &over("sharp"));
    assert_eq!(found.mean, Some(0.375), "of fox and hare");
    let shares: Vec<f64> = found.captures.iter().map(|capture| capture.share).collect();
    assert_eq!(shares[..2], [0.25, 0.5]);
    assert!(!found.captures[2].counts());
}
