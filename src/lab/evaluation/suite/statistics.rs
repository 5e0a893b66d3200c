//! The significance of the difference between two configurations.
//!
//! Only runs that differ in nothing but the configuration are compared: the same capture, seed and
//! test view. A capture's difference is the mean over its pairs. The bootstrap resamples captures,
//! not views, because the views of a capture share its light, its poses and its luck.

use std::collections::BTreeSet;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Serialize;

use super::outcome::SuiteRun;
use crate::evaluation::report::{Scores, TestView, ViewScores};

/// Resamples of the bootstrap.
const RESAMPLES: usize = 10_000;
/// Seed of the bootstrap: the same runs give the same interval.
const SEED: u64 = 0x5017e;
/// Percentiles that bound 95 % of the resamples.
const BOUNDS: [f64; 2] = [0.025, 0.975];
/// Minimum number of captures for a claim: the interval of fewer is far too narrow.
pub const LEAST_CAPTURES: usize = 6;
/// Minimum number of seeds for a claim: with fewer, the effect of the seed itself would not show.
pub const LEAST_SEEDS: usize = 2;
/// Minimum distance from floor to ceiling, dB; below it, a share is noise.
pub const LEAST_CEILING_DB: f64 = 1.0;

/// A measure of quality.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// PSNR after a colour fit, dB.
    PsnrCc,
    /// PSNR after a colour fit over the pixels that two training views see, dB.
    PsnrCcSeen,
    /// SSIM.
    Ssim,
    /// LPIPS, lower is better.
    Lpips,
    /// PSNR of detail finer than 3 px, dB.
    Fine,
}

impl Measure {
    /// All measures, in the order of the tables.
    pub const ALL: [Self; 5] =
        [Self::PsnrCc, Self::PsnrCcSeen, Self::Ssim, Self::Lpips, Self::Fine];

    /// The value of the measure; `None` if a view has none.
    pub fn of(self, scores: &ViewScores) -> Option<f64> {
        let all = &scores.all;
        match self {
            Self::PsnrCc => Some(all.psnr_cc_db),
            Self::PsnrCcSeen => scores.seen.as_ref().map(|Scores { psnr_cc_db, .. }| *psnr_cc_db),
            Self::Ssim => Some(all.ssim),
            Self::Lpips => all.lpips_squeeze,
            Self::Fine => Some(all.psnr_fine_db),
        }
    }
}

/// The cameras of the renders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cameras {
    /// Registered to the sharp photographs: the quality of the scene.
    Registered,
    /// Mapped from the truth: also contains the effect of camera errors.
    Mapped,
}

impl Cameras {
    /// Both; claims use the first.
    pub const ALL: [Self; 2] = [Self::Registered, Self::Mapped];

    /// A view's scores.
    pub fn of(self, view: &TestView) -> &ViewScores {
        match self {
            Self::Registered => &view.registered,
            Self::Mapped => &view.mapped,
        }
    }
}

/// The advantage of a configuration over another.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Name of the configuration.
    pub of: String,
    /// Name of the baseline.
    pub over: String,
    pub measure: Measure,
    pub cameras: Cameras,
    /// By capture; captures without a pair are left out.
    pub captures: Vec<CaptureDifference>,
    /// Mean over the captures, with equal weights.
    pub mean: f64,
    /// 95 % percentile bootstrap over the captures; `None` for a single one.
    pub interval: Option<[f64; 2]>,
}

/// The advantage of a configuration over another on one capture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaptureDifference {
    /// Name of the capture.
    pub capture: String,
    /// Mean over the pairs.
    pub mean: f64,
    /// Number of test views of all seeds that both have.
    pub pairs: usize,
    /// Number of seeds that both have.
    pub seeds: usize,
}

impl Difference {
    /// Whether there are enough captures and seeds for a claim.
    pub fn can_be_claimed(&self) -> bool {
        let seeds = self.captures.iter().map(|capture| capture.seeds).min();
        self.captures.len() >= LEAST_CAPTURES && seeds.is_some_and(|least| least >= LEAST_SEEDS)
    }
}

/// The difference in one measure; `None` if no capture has a pair.
pub fn difference(
    runs: &[SuiteRun],
    (of, over): (&str, &str),
    measure: Measure,
    cameras: Cameras,
) -> Option<Difference> {
    let mut names: Vec<&str> = Vec::new();
    for run in runs {
        if !names.contains(&run.capture.as_str()) {
            names.push(&run.capture);
        }
    }
    let score = |view: &TestView| measure.of(cameras.of(view));
    let captures: Vec<CaptureDifference> = names
        .into_iter()
        .filter_map(|capture| of_capture(runs, capture, (of, over), score))
        .collect();
    let values: Vec<f64> = captures.iter().map(|capture| capture.mean).collect();
    Some(Difference {
        of: of.to_owned(),
        over: over.to_owned(),
        measure,
        cameras,
        mean: mean(&values)?,
        interval: interval(&values),
        captures,
    })
}

fn of_capture(
    runs: &[SuiteRun],
    capture: &str,
    (of, over): (&str, &str),
    score: impl Fn(&TestView) -> Option<f64>,
) -> Option<CaptureDifference> {
    let on = |name| {
        let here = runs
            .iter()
            .filter(move |run: &&SuiteRun| run.capture == capture && run.configuration == name);
        here.filter_map(|run| Some((run.seed, &run.judged()?.evaluation.views)))
    };
    let (mut values, mut seeds) = (Vec::new(), BTreeSet::new());
    for (seed, views) in on(of) {
        for (_, others) in on(over).filter(|(other, _)| *other == seed) {
            for view in views {
                let same = others.iter().find(|other| other.name == view.name);
                let (a, b) = (score(view), same.and_then(&score));
                if let (Some(a), Some(b)) = (a, b) {
                    values.push(a - b);
                    seeds.insert(seed);
                }
            }
        }
    }
    Some(CaptureDifference {
        capture: capture.to_owned(),
        mean: mean(&values)?,
        pairs: values.len(),
        seeds: seeds.len(),
    })
}

/// How much of the way from `over` to the ceiling a configuration covers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reached {
    /// By capture.
    pub captures: Vec<CaptureReached>,
    /// Mean share over the captures whose ceiling is more than [`LEAST_CEILING_DB`] above; `None`
    /// if there are none.
    pub mean: Option<f64>,
    /// Its 95 % interval, as for a difference.
    pub interval: Option<[f64; 2]>,
}

/// The share on one capture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaptureReached {
    /// Name of the capture.
    pub capture: String,
    /// of - over, dB.
    pub gained_db: f64,
    /// ceiling - over, dB.
    pub ceiling_db: f64,
    /// `gained_db` over `ceiling_db`.
    pub share: f64,
}

impl CaptureReached {
    /// Whether the ceiling is high enough for a share.
    pub fn counts(&self) -> bool {
        self.ceiling_db > LEAST_CEILING_DB
    }
}

/// The shares, from the differences of `of` and of the ceiling to the same baseline.
pub fn reached(of: &Difference, ceiling: &Difference) -> Reached {
    let captures: Vec<CaptureReached> = of
        .captures
        .iter()
        .filter_map(|gained| {
            let same = |other: &&CaptureDifference| other.capture == gained.capture;
            let ceiling_db = ceiling.captures.iter().find(same)?.mean;
            Some(CaptureReached {
                capture: gained.capture.clone(),
                gained_db: gained.mean,
                ceiling_db,
                share: gained.mean / ceiling_db,
            })
        })
        .collect();
    let counting = captures.iter().filter(|capture| capture.counts());
    let shares: Vec<f64> = counting.map(|capture| capture.share).collect();
    Reached { mean: mean(&shares), interval: interval(&shares), captures }
}

/// The mean; `None` without values.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// 95 % percentile bootstrap of the mean; `None` for fewer than two values.
pub fn interval(values: &[f64]) -> Option<[f64; 2]> {
    if values.len() < 2 {
        return None;
    }
    let mut rng = Pcg64Mcg::seed_from_u64(SEED);
    let mut resample = || {
        let drawn = (0..values.len()).map(|_| values[rng.random_range(0..values.len())]);
        drawn.sum::<f64>() / values.len() as f64
    };
    let mut means: Vec<f64> = (0..RESAMPLES).map(|_| resample()).collect();
    means.sort_by(f64::total_cmp);
    Some(BOUNDS.map(|share| percentile(&means, share)))
}

/// The value below which this share of the sorted values lies, linearly interpolated.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let at = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    low + (high - low) * at.fract()
}

#[cfg(test)]
mod tests;
