//! What became of a run.

use serde::{Deserialize, Serialize};

use crate::evaluation::report::Evaluation;
use fled_core::metrics::Report;

/// What was asked for, or why there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome<T> {
    /// It is there.
    Finished(T),
    /// The last error line of whoever should have made it.
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
    /// What became of it.
    pub outcome: Outcome<Judged>,
}

impl SuiteRun {
    /// What is known of a run that did not fail.
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
    /// Seconds that all rounds trained.
    pub training_seconds: f64,
    /// Seconds that all stages took, the poses as long as they took when they were found.
    pub total_seconds: f64,
    /// What sharp photographs say.
    pub evaluation: Evaluation,
}

impl Judged {
    /// Of a run's report and evaluation.
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

/// Seconds that all rounds trained.
pub fn training_seconds(report: &Report) -> f64 {
    let seconds =
        |round: &fled_core::metrics::RoundMetrics| round.steps as f64 / round.steps_per_second;
    report.rounds.iter().map(seconds).sum()
}
