//! `fled watch`: shows the progress of a job until it is over.

use std::time::Duration;

use fled_core::metrics::RoundMetrics;
use fled_core::pipeline::error::ErrorKind;
use indicatif::ProgressBar;
use serde::Deserialize;

use super::Remote;
use crate::failure::Failure;
use crate::progress::{name, overall_bar, round_lines, show_progress};

/// Pause between two requests for the job.
const PERIOD: Duration = Duration::from_secs(1);

/// Arguments of `fled watch`.
#[derive(clap::Args)]
pub struct Args {
    /// ID of the job, as printed by `fled submit`.
    job: String,
    #[command(flatten)]
    remote: super::Args,
}

/// The displayed fields of a job.
#[derive(Deserialize)]
struct Job {
    name: String,
    state: String,
    stage: Option<String>,
    round: u32,
    rounds: u32,
    progress: f64,
    steps_per_second: Option<f64>,
    eta_seconds: Option<f64>,
    error: Option<JobError>,
    warnings: Vec<Warning>,
    stages: Vec<Stage>,
    attempts: u32,
    best_round: Option<u32>,
}

#[derive(Deserialize)]
struct JobError {
    code: String,
    detail: String,
    hint: String,
}

#[derive(Deserialize)]
struct Warning {
    code: String,
    message: String,
}

#[derive(Deserialize)]
struct Stage {
    stage: String,
    round: u32,
    seconds: f64,
}

#[derive(Deserialize)]
struct Rounds {
    rounds: Vec<RoundMetrics>,
}

/// Shows a job until it is over.
///
/// # Errors
/// [`Failure`] of the job's own kind if it fails, or if it is cancelled.
pub fn main(args: &Args) -> Result<(), Failure> {
    watch(&Remote::new(&args.remote)?, &args.job)
}

/// Like [`main`].
pub fn watch(remote: &Remote, id: &str) -> Result<(), Failure> {
    let screen = Screen::new();
    let mut shown = Shown::default();
    loop {
        let job: Job = remote.json(&format!("/v1/jobs/{id}"))?;
        shown.update(&job, &screen);
        let left = job.eta_seconds.filter(|_| job.state == "running");
        show_progress(&screen.bar, job.progress, left);
        screen.bar.set_message(doing(&job));
        match job.state.as_str() {
            "succeeded" => {
                let rounds: Rounds = remote.json(&format!("/v1/jobs/{id}/rounds"))?;
                rounds.rounds.iter().flat_map(round_lines).for_each(|line| screen.line(&line));
                let best = job.best_round.unwrap_or(job.rounds);
                screen.line(&format!("{} is finished; round {best} is delivered", job.name));
                screen.bar.finish_and_clear();
                return Ok(());
            }
            "failed" | "cancelled" => {
                screen.bar.finish_and_clear();
                return Err(end(job));
            }
            _ => std::thread::sleep(PERIOD),
        }
    }
}

/// Why a job did not succeed.
fn end(job: Job) -> Failure {
    let Some(error) = job.error.filter(|_| job.state == "failed") else {
        let mut failure = Failure::new(ErrorKind::Internal, "the job was cancelled");
        "Continue it with `fled retry` or in the dashboard.".clone_into(&mut failure.hint);
        return failure;
    };
    Failure {
        kind: ErrorKind::from_name(&error.code).unwrap_or(ErrorKind::Internal),
        detail: error.detail,
        hint: error.hint,
        wrong_use: false,
    }
}

/// A bar on a terminal, plain lines otherwise.
struct Screen {
    bar: ProgressBar,
}

impl Screen {
    fn new() -> Self {
        Self { bar: overall_bar() }
    }

    fn line(&self, text: &str) {
        if self.bar.is_hidden() {
            eprintln!("{text}");
        } else {
            self.bar.println(text);
        }
    }
}

/// The state shown so far.
#[derive(Default)]
struct Shown {
    state: String,
    attempts: u32,
    stages: usize,
    warnings: usize,
}

impl Shown {
    /// Shows what has changed.
    fn update(&mut self, job: &Job, screen: &Screen) {
        // A new attempt may have fewer stages and warnings.
        for stage in job.stages.iter().skip(self.stages) {
            let name = name(&stage.stage, stage.round);
            screen.line(&format!("{name} done in {:.1} s", stage.seconds));
        }
        for warning in job.warnings.iter().skip(self.warnings) {
            screen.line(&format!("warning ({}): {}", warning.code, warning.message));
        }
        if self.state != job.state || self.attempts != job.attempts {
            let attempt = match job.attempts {
                0 | 1 => String::new(),
                attempts => format!(", attempt {attempts}"),
            };
            screen.line(&format!("{} is {}{attempt}", job.name, job.state));
            self.state.clone_from(&job.state);
            self.attempts = job.attempts;
        }
        self.stages = job.stages.len();
        self.warnings = job.warnings.len();
    }
}

fn doing(job: &Job) -> String {
    if job.state != "running" {
        return job.state.clone();
    }
    let stage = job.stage.as_deref().map(|stage| name(stage, job.round));
    let rate = job.steps_per_second.map(|rate| format!("{rate:.1} steps/s"));
    let parts: Vec<String> = [stage, rate].into_iter().flatten().collect();
    parts.join(", ")
}
