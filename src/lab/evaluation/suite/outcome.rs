//! The outcome of a run.

use serde::{Deserialize, Serialize};

use crate::evaluation::report::Evaluation;
use fled_core::metrics::Report;

/// A result, or the reason why there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome<T> {
    /// The result.
    Finished(T),
    /// The last error line of the process that should have made it.
    Failed(String),
}

/// A run of a suite, by its place in it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SuiteRun {
    /// Name of the capture.
    pub capture: String,
    /// Name of the configuration.
    pub configuration: String,
    /// Its seed.
    pub seed: u64,
    pub outcome: Outcome<Judged>,
}

impl SuiteRun {
    /// The result of a run that did not fail.
    pub fn judged(&self) -> Option<&Judged> {
        match &self.outcome {
            Outcome::Finished(judged) => Some(judged),
            Outcome::Failed(_) => None,
        }
    }
}

/// A run that has been judged.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// Name of its record and its folder.
    pub run: String,
    /// Optimiser steps of all rounds together.
    pub steps: u64,
    /// Seconds of training in all rounds.
    pub training_seconds: f64,
    /// Seconds of all stages; for the poses, the time that finding them took originally.
    pub total_seconds: f64,
    /// The scores against sharp photographs.
    pub evaluation: Evaluation,
}

impl Judged {
    pub fn new(run: String, report: &Report, evaluation: Evaluation) -> Self {
        Self {
            run,
            steps: steps(report),
            training_seconds: training_seconds(report),
            total_seconds: report.stages.values().sum(),
            evaluation,
        }
    }
}

/// Optimiser steps of all rounds together.
pub fn steps(report: &Report) -> u64 {
    report.rounds.iter().map(|round| round.steps).sum()
}

/// Seconds of training in all rounds.
pub fn training_seconds(report: &Report) -> f64 {
    let seconds =
        |round: &fled_core::metrics::RoundMetrics| round.steps as f64 / round.steps_per_second;
    report.rounds.iter().map(seconds).sum()
}
