//! Synthetic runs with the scores that a test needs.

use crate::evaluation::report::{Evaluation, Scores, TestView, ViewScores};
use crate::evaluation::suite::outcome::{Judged, Outcome, SuiteRun};

/// A test view with these scores: 1 dB more where two views see it, 5 dB less with mapped cameras.
pub fn view(name: &str, psnr_cc_db: f64) -> TestView {
    let scores = |psnr_cc_db| Scores {
        psnr_db: psnr_cc_db - 1.0,
        psnr_cc_db,
        psnr_fine_db: psnr_cc_db + 2.0,
        ssim: psnr_cc_db / 100.0,
        lpips_squeeze: None,
    };
    let both =
        |psnr_cc_db| ViewScores { all: scores(psnr_cc_db), seen: Some(scores(psnr_cc_db + 1.0)) };
    TestView {
        name: name.to_owned(),
        nearest: "nearest".to_owned(),
        seen: 0.9,
        moved_px: 0.5,
        mapped: both(psnr_cc_db - 5.0),
        registered: both(psnr_cc_db),
    }
}

/// The evaluation of these views; the means are those of the first.
pub fn evaluation(views: &[(&str, f64)]) -> Evaluation {
    let views: Vec<TestView> = views.iter().map(|(name, psnr)| view(name, *psnr)).collect();
    Evaluation {
        training_views: 12,
        tied_views: 12,
        camera_error: 0.01,
        gaussians: 900,
        elongated: 7,
        size: 128,
        adapter: "none".to_owned(),
        lpips_network: None,
        mapped: views[0].mapped,
        registered: views[0].registered,
        views,
    }
}

/// A judged run whose test views have these scores.
pub fn run(capture: &str, configuration: &str, seed: u64, views: &[(&str, f64)]) -> SuiteRun {
    SuiteRun {
        capture: capture.to_owned(),
        configuration: configuration.to_owned(),
        seed,
        outcome: Outcome::Finished(Judged {
            run: format!("{capture}-{configuration}-{seed}"),
            steps: 100,
            training_seconds: 10.0,
            total_seconds: 25.0,
            evaluation: evaluation(views),
        }),
    }
}
