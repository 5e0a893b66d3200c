//! The scores of a played round.

use std::collections::BTreeMap;

use fled_core::camera::Split;
use fled_core::enhance::Anchor;
use fled_core::metrics::{
    Brightness, CaptureExposure, ImageKind, Record, Reference, RoundMetrics, ViewExposure,
    ViewScore,
};

/// Score of the brightened photographs of the training views, dB.
const PHOTOGRAPHS_DB: f64 = 17.0;
/// Scores of single views relative to the mean, dB.
const SPREAD_DB: [f64; 4] = [0.0, 0.6, -0.6, 0.0];
/// Loss of score of held-out views, dB.
const HELD_OUT_LESS_DB: f64 = 1.5;

/// The metrics of a round of the photographs `names`. `plan` is the job's, `None` without ground
/// truth: the renders of "little" and "worse" gain less over the photographs than those of others.
pub fn metrics(round: u32, names: &[String], plan: Option<&String>) -> RoundMetrics {
    let gain = match plan.map(String::as_str) {
        Some("little") => 0.4,
        Some("worse") => -0.8,
        _ => 3.0 + f64::from(round),
    };
    RoundMetrics {
        round,
        seconds: 1.0,
        gaussians: 10_000,
        steps: 1_000,
        steps_per_second: 25.0,
        between: None,
        records: records(round, gain, plan.is_some()),
        views: views(names, gain, plan.is_some()),
        noise_sigma: BTreeMap::from([("enhanced".to_owned(), 0.02), ("render".to_owned(), 0.01)]),
        sharpness: BTreeMap::from([("render".to_owned(), 0.2)]),
        mean_brightness: 0.4,
        clipped: 0.01,
        noise_ceiling_db: 30.0,
        noise_map: None,
        expected_noise: Some(0.03),
        lowered_cap: None,
        kernels: 3,
        shake_px: Some(0.4),
        pose_correction_px: Some(0.1),
        non_finite_gradients: 0,
        anchor: Anchor::exposure(3.5),
        matched: Vec::new(),
        score: Some(27.5),
        worse_than_previous: false,
    }
}

fn records(round: u32, gain: f64, has_truth: bool) -> Vec<Record> {
    let record = |split, image, psnr: f64, reference| Record {
        split,
        image,
        reference,
        brightness: Brightness::Final,
        views: 3,
        psnr_db: psnr - 1.0,
        psnr_cc_db: psnr,
        ssim: (psnr - 1.0) / 40.0,
        lpips_squeeze: None,
    };
    let of_split = |split| {
        let less = if split == Split::HeldOut { HELD_OUT_LESS_DB } else { 0.0 };
        let base = PHOTOGRAPHS_DB - less;
        let deblurred = base + 2.0 + f64::from(round);
        let consistent = base + 10.0 + f64::from(round);
        [
            record(split, ImageKind::Enhanced, base, Reference::Gt),
            record(split, ImageKind::Deblurred, deblurred, Reference::Gt),
            record(split, ImageKind::Render, base + gain, Reference::Gt),
            record(split, ImageKind::Render, consistent, Reference::Deblurred),
        ]
    };
    let all = [Split::Train, Split::HeldOut].into_iter().flat_map(of_split);
    all.filter(|record| has_truth || record.reference != Reference::Gt).collect()
}

/// A row per photograph: the second of every four is shaken, and the third scores worst.
fn views(names: &[String], gain: f64, has_truth: bool) -> Vec<ViewScore> {
    let row = |(i, name): (usize, &String)| {
        let is_shaken = i % 4 == 1;
        let agreement = 26.0 + SPREAD_DB[i % 4] + 0.1 * i as f64;
        let psnr = if has_truth { PHOTOGRAPHS_DB + gain + SPREAD_DB[i % 4] } else { agreement };
        ViewScore {
            name: name.clone(),
            registered: true,
            split: Some(if i.is_multiple_of(8) { Split::HeldOut } else { Split::Train }),
            reference: Some(if has_truth { Reference::Gt } else { Reference::Enhanced }),
            psnr_db: Some(psnr - 1.0),
            psnr_cc_db: Some(psnr),
            ssim: Some((psnr - 1.0) / 40.0),
            photograph_psnr_cc_db: has_truth.then_some(PHOTOGRAPHS_DB),
            shake_px: Some(if is_shaken { 2.0 + i as f64 } else { 0.3 }),
            is_shaken: Some(is_shaken),
            fit: Some(0.95),
        }
    };
    names.iter().enumerate().map(row).collect()
}

/// Exposures of the photographs: every other one has 1.2 stops more light.
pub fn exposure(names: &[String]) -> CaptureExposure {
    let of = |i: usize| if i.is_multiple_of(2) { -0.6 } else { 0.6 };
    let view = |(i, name): (usize, &String)| {
        let stops = of(i);
        let seconds = Some(0.05);
        (
            name.clone(),
            ViewExposure { stops, tint: [0.0; 2], seconds, iso: Some(800.0), f_number: None },
        )
    };
    CaptureExposure {
        share: 1.0,
        verdict: "evened: the played surfaces agree".to_owned(),
        spread_stops: [-0.6, 0.6],
        residual_stops: Some(0.05),
        pairs: 12,
        exif_slope: None,
        left_out_error: None,
        views: names.iter().enumerate().map(view).collect(),
    }
}
