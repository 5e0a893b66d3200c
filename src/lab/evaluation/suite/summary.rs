//! The results of a suite: rows of scores, differences, and the share of the ceiling.

use serde::Serialize;

use super::file::{Gain, OptionSet, Suite};
use super::outcome::{Judged, Outcome, SuiteRun};
use super::statistics::{Cameras, Difference, Measure, Reached, difference, mean, reached};

/// The results of a suite, and what they refer to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The question that the suite answers.
    pub question: String,
    /// Name of the preset of every run.
    pub preset: String,
    /// Options of every run.
    pub set: OptionSet,
    /// The number of seeds requested, from 0.
    pub seeds: u64,
    /// The existing rows by capture and configuration.
    pub rows: Vec<Row>,
    /// Means over the captures, for configurations that finished on all of them.
    pub means: Vec<Row>,
    /// Differences of every configuration to the first.
    pub differences: Vec<Difference>,
    /// The share of the ceiling, if the suite asks for it and the runs exist.
    pub gain: Option<Share>,
    /// Every run, in the order in which they were due.
    pub runs: Vec<SuiteRun>,
}

/// A configuration on a capture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the capture; `None` for a mean over all of them.
    pub capture: Option<String>,
    /// Name of the configuration.
    pub configuration: String,
    /// Means over the runs; `None` if all failed.
    pub scores: Option<RowScores>,
    /// Number of runs that finished; for all captures, the fewest.
    pub finished: usize,
    /// Number of runs that failed.
    pub failed: usize,
}

/// Mean scores of some runs, with registered cameras unless stated otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RowScores {
    /// PSNR after a colour fit, dB.
    pub psnr_cc_db: f64,
    /// PSNR after a colour fit over the pixels that two training views see, dB.
    pub psnr_cc_seen_db: Option<f64>,
    /// PSNR after a colour fit with mapped cameras, dB.
    pub psnr_cc_mapped_db: f64,
    /// SSIM.
    pub ssim: f64,
    /// LPIPS.
    pub lpips_squeeze: Option<f64>,
    /// PSNR of detail finer than 3 px, dB.
    pub psnr_fine_db: f64,
    /// Number of elongated Gaussians.
    pub elongated: f64,
    /// Number of Gaussians.
    pub gaussians: f64,
    /// Optimiser steps of all rounds.
    pub steps: f64,
    /// Seconds of training in all rounds.
    pub training_seconds: f64,
    /// Seconds of all stages.
    pub total_seconds: f64,
}

/// How much of the way from one configuration to another a third covers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Share {
    /// The configuration to be judged.
    pub of: String,
    /// The baseline.
    pub over: String,
    /// The upper bound.
    pub ceiling: String,
    /// The share, in PSNR after a colour fit with registered cameras.
    pub reached: Reached,
}

impl Summary {
    /// Summarises the runs of a suite.
    pub fn new(suite: &Suite, runs: Vec<SuiteRun>) -> Self {
        let captures: Vec<&str> = suite.captures.iter().map(|c| c.name.as_str()).collect();
        let names: Vec<&str> = suite.configurations.iter().map(|c| c.name.as_str()).collect();
        let rows: Vec<Row> = captures
            .iter()
            .flat_map(|capture| names.iter().filter_map(|name| row(&runs, capture, name)))
            .collect();
        let means = names.iter().filter_map(|name| mean_row(&rows, name, captures.len()));
        Self {
            question: suite.question.clone(),
            preset: suite.preset.name().to_owned(),
            set: suite.set.clone(),
            seeds: suite.seeds,
            means: means.collect(),
            differences: differences(&runs, &names),
            gain: suite.gain.as_ref().and_then(|gain| share(&runs, gain)),
            rows,
            runs,
        }
    }
}

fn row(runs: &[SuiteRun], capture: &str, configuration: &str) -> Option<Row> {
    let here = |run: &&SuiteRun| run.capture == capture && run.configuration == configuration;
    let of: Vec<&SuiteRun> = runs.iter().filter(here).collect();
    let scores: Vec<RowScores> =
        of.iter().filter_map(|run| run.judged().map(RowScores::of)).collect();
    let failed = |run: &&&SuiteRun| matches!(run.outcome, Outcome::Failed(_));
    (!of.is_empty()).then(|| Row {
        capture: Some(capture.to_owned()),
        configuration: configuration.to_owned(),
        scores: RowScores::mean(&scores),
        finished: scores.len(),
        failed: of.iter().filter(failed).count(),
    })
}

fn mean_row(rows: &[Row], configuration: &str, captures: usize) -> Option<Row> {
    let of: Vec<&Row> = rows
        .iter()
        .filter(|row| row.configuration == configuration && row.scores.is_some())
        .collect();
    let scores: Vec<RowScores> = of.iter().filter_map(|row| row.scores).collect();
    (captures > 1 && of.len() == captures).then(|| Row {
        capture: None,
        configuration: configuration.to_owned(),
        scores: RowScores::mean(&scores),
        finished: of.iter().map(|row| row.finished).min().unwrap_or(0),
        failed: of.iter().map(|row| row.failed).sum(),
    })
}

fn differences(runs: &[SuiteRun], names: &[&str]) -> Vec<Difference> {
    let Some((first, others)) = names.split_first() else {
        return Vec::new();
    };
    let mut found = Vec::new();
    for name in others {
        for cameras in Cameras::ALL {
            let of = |measure| difference(runs, (name, first), measure, cameras);
            found.extend(Measure::ALL.into_iter().filter_map(of));
        }
    }
    found
}

fn share(runs: &[SuiteRun], gain: &Gain) -> Option<Share> {
    let over =
        |name: &str| difference(runs, (name, &gain.over), Measure::PsnrCc, Cameras::Registered);
    let Gain { of, over: floor, ceiling } = gain.clone();
    Some(Share { reached: reached(&over(&of)?, &over(&ceiling)?), of, over: floor, ceiling })
}

impl RowScores {
    fn of(judged: &Judged) -> Self {
        let evaluation = &judged.evaluation;
        let (registered, mapped) = (&evaluation.registered, &evaluation.mapped);
        Self {
            psnr_cc_db: registered.all.psnr_cc_db,
            psnr_cc_seen_db: registered.seen.map(|seen| seen.psnr_cc_db),
            psnr_cc_mapped_db: mapped.all.psnr_cc_db,
            ssim: registered.all.ssim,
            lpips_squeeze: registered.all.lpips_squeeze,
            psnr_fine_db: registered.all.psnr_fine_db,
            elongated: evaluation.elongated as f64,
            gaussians: evaluation.gaussians as f64,
            steps: judged.steps as f64,
            training_seconds: judged.training_seconds,
            total_seconds: judged.total_seconds,
        }
    }

    /// Means of each field over the items that have it; `None` if there are none.
    fn mean(of: &[Self]) -> Option<Self> {
        let always = |field: fn(&Self) -> f64| mean(&of.iter().map(field).collect::<Vec<_>>());
        let where_there = |field: fn(&Self) -> Option<f64>| {
            mean(&of.iter().filter_map(field).collect::<Vec<_>>())
        };
        Some(Self {
            psnr_cc_db: always(|of| of.psnr_cc_db)?,
            psnr_cc_seen_db: where_there(|of| of.psnr_cc_seen_db),
            psnr_cc_mapped_db: always(|of| of.psnr_cc_mapped_db)?,
            ssim: always(|of| of.ssim)?,
            lpips_squeeze: where_there(|of| of.lpips_squeeze),
            psnr_fine_db: always(|of| of.psnr_fine_db)?,
            elongated: always(|of| of.elongated)?,
            gaussians: always(|of| of.gaussians)?,
            steps: always(|of| of.steps)?,
            training_seconds: always(|of| of.training_seconds)?,
            total_seconds: always(|of| of.total_seconds)?,
        })
    }
}
