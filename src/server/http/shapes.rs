//! The JSON types of the public API.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use crate::jobs::state::JobState;
use crate::store::{CaptureRow, JobRow, ToldJob};
use crate::validation::{CaptureReport, Warning};

/// A capture as answered: its assessments and how many photographs can be used.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Capture {
    /// UUID v7; absent on a dry run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// The user's name for it.
    pub name: String,
    /// When it was stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub created_at: Option<String>,
    /// When it will be deleted, unless a job is made of it: RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expires_at: Option<String>,
    /// What became of each file, and what is worth knowing of all.
    #[serde(flatten)]
    pub report: CaptureReport,
}

/// A page of captures.
#[derive(Debug, Serialize, ToSchema)]
pub struct Captures {
    /// Newest first.
    pub captures: Vec<Capture>,
    /// `cursor` of the next page, where there is one.
    pub next_cursor: Option<String>,
}

impl Capture {
    pub fn from_row(row: CaptureRow) -> Self {
        let report = report(&row);
        Self {
            id: Some(row.id),
            name: row.name,
            created_at: Some(time(row.created_at)),
            expires_at: row.expires_at.map(time),
            report,
        }
    }
}

/// The assessments of a stored capture.
pub fn report(row: &CaptureRow) -> CaptureReport {
    CaptureReport::deserialize(&row.report).unwrap_or_else(|error| {
        tracing::error!(%error, capture = row.id, "its assessments are damaged");
        CaptureReport {
            accepted: row.accepted,
            ..CaptureReport::default()
        }
    })
}

/// A job as answered.
#[derive(Debug, Serialize, ToSchema)]
pub struct Job {
    /// UUID v7.
    pub id: String,
    /// The user's name for it.
    pub name: String,
    /// Its capture.
    pub capture_id: String,
    /// Where it stands.
    pub state: JobState,
    /// The stage that runs: poses, enhance, deblur, reconstruct, render, match or evaluate.
    pub stage: Option<String>,
    /// When that stage began: RFC 3339; `null` when the job does not run or has told of none yet.
    pub stage_started_at: Option<String>,
    /// The place of a queued job among all that wait, 1 being the next; `null` for others. One that
    /// waits for another attempt keeps its place and may be passed.
    pub queue_position: Option<u32>,
    /// Of two jobs that wait the higher one goes first.
    pub priority: i64,
    /// What a machine must have that a queued job waits for; `null` where any will do.
    pub waits_for: Option<String>,
    /// The round that runs or ran last, 1-based; 0 before the first.
    pub round: u32,
    /// Rounds planned.
    pub rounds: u32,
    /// Share of the expected work that is done, 0..=1.
    pub progress: f64,
    /// Training speed, while it trains.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps_per_second: Option<f64>,
    /// Estimated seconds left, while it runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eta_seconds: Option<f64>,
    /// Why it failed.
    pub error: Option<JobError>,
    /// What the user should know.
    pub warnings: Vec<Warning>,
    /// The delivered round of a finished job.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub best_round: Option<u32>,
    /// Whether somebody asked to stop it.
    pub cancel_requested: bool,
    /// Attempts begun.
    pub attempts: u32,
    /// Name of its preset.
    pub preset: String,
    /// Its options, complete.
    #[schema(value_type = Object)]
    pub options: Value,
    /// Wall seconds of every finished stage.
    pub stages: Vec<StageTime>,
    /// RFC 3339.
    pub created_at: String,
    /// RFC 3339; first attempt.
    pub started_at: Option<String>,
    /// RFC 3339.
    pub finished_at: Option<String>,
    /// Whether it is kept, whatever the server deletes of itself.
    pub pinned: bool,
    /// When it will be deleted: RFC 3339.
    pub expires_at: Option<String>,
}

/// Why a job failed.
#[derive(Debug, Serialize, ToSchema)]
pub struct JobError {
    /// bad_input, few_poses, oom_host, oom_gpu, device_lost, io, timeout, environment or internal.
    pub code: String,
    /// What happened.
    pub detail: String,
    /// What to do about it.
    pub hint: String,
}

/// The time of a stage.
#[derive(Debug, Serialize, ToSchema)]
pub struct StageTime {
    /// Its name.
    pub stage: String,
    /// 1-based; 0 for the poses.
    pub round: u32,
    /// Wall seconds.
    pub seconds: f64,
}

/// A page of jobs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Jobs {
    /// Newest first.
    pub jobs: Vec<Job>,
    /// `cursor` of the next page, where there is one.
    pub next_cursor: Option<String>,
}

impl Job {
    pub fn from_told(told: ToldJob) -> Self {
        let ToldJob {
            row,
            warnings,
            stages,
            queue_position,
            stage_started_at,
        } = told;
        Self {
            warnings: warnings
                .into_iter()
                .map(|warning| Warning {
                    code: warning.code,
                    message: warning.message,
                })
                .collect(),
            stages: stages
                .into_iter()
                .map(|stage| StageTime {
                    stage: stage.stage,
                    round: stage.round,
                    seconds: stage.seconds,
                })
                .collect(),
            waits_for: waits_for(&row),
            id: row.id,
            name: row.name,
            capture_id: row.capture_id,
            state: row.state,
            stage: row.stage,
            stage_started_at: stage_started_at.map(time),
            queue_position,
            priority: row.priority,
            round: row.round,
            rounds: row.rounds,
            progress: row.progress,
            steps_per_second: row.steps_per_second,
            eta_seconds: row.eta_seconds,
            error: row.error.map(|error| JobError {
                code: error.code,
                detail: error.detail,
                hint: error.hint,
            }),
            best_round: row.best_round,
            cancel_requested: row.cancel_requested,
            attempts: row.attempts,
            preset: row.preset,
            options: row.options,
            created_at: time(row.created_at),
            started_at: row.started_at.map(time),
            finished_at: row.finished_at.map(time),
            pinned: row.pinned,
            expires_at: row.expires_at.map(time),
        }
    }
}

/// The resources that a queued job waits for.
fn waits_for(row: &JobRow) -> Option<String> {
    let queued = row.state == JobState::Queued;
    (queued && row.needs.gpu).then(|| {
        let memory = row.needs.memory >> 30;
        format!("a worker with a GPU and {memory} GiB of memory")
    })
}

/// RFC 3339 in UTC.
pub(super) fn time(milliseconds: i64) -> String {
    jiff::Timestamp::from_millisecond(milliseconds)
        .unwrap_or_default()
        .to_string()
}
