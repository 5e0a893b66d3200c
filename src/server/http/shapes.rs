//! The JSON types of the public API.

use fled_core::camera::Split;
use fled_core::capture::{CaptureWarning, view_names};
use fled_core::metrics::Reference;
use fled_core::poses::overlap::Overlap;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;
use utoipa::openapi::Ref;

use crate::app::crew::Crew;
use crate::store::state::JobState;
use crate::store::{CaptureRow, JobDetails, JobRow};
use crate::validation::{CaptureReport, warnings};

/// A capture with the assessments of its photographs.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Capture {
    /// UUID v7; absent after a dry run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// Name given by the user.
    pub name: String,
    /// Time of the upload, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub created_at: Option<String>,
    /// Time at which the capture is deleted unless a job uses it, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expires_at: Option<String>,
    /// The assessments of its files, and warnings about the whole capture.
    #[serde(flatten)]
    pub report: CaptureReport,
}

/// A page of captures.
#[derive(Debug, Serialize, ToSchema)]
pub struct Captures {
    /// The captures, newest first.
    pub captures: Vec<Capture>,
    /// `cursor` of the next page, if there is one.
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

/// The assessments of a stored capture, with the names of its views.
pub fn report(row: &CaptureRow) -> CaptureReport {
    let mut report = CaptureReport::deserialize(&row.report).unwrap_or_else(|error| {
        tracing::error!(%error, capture = row.id, "the capture's assessments are damaged");
        CaptureReport { accepted: row.accepted, ..CaptureReport::default() }
    });
    // Reports of earlier builds lack them.
    let accepted = || report.images.iter().filter(|image| image.accepted);
    let views = view_names(accepted().map(|image| image.name.as_str()));
    let used = { report.images.iter_mut() }.filter(|image| image.accepted);
    used.zip(views).for_each(|(image, view)| image.view = Some(view));
    report
}

/// A job.
#[derive(Debug, Serialize, ToSchema)]
pub struct Job {
    /// UUID v7.
    pub id: String,
    /// Name given by the user.
    pub name: String,
    /// Tags given by the user.
    pub tags: Vec<String>,
    /// ID of its capture.
    pub capture_id: String,
    /// State.
    pub state: JobState,
    /// Current stage: poses, enhance, deblur, reconstruct, render, match or evaluate.
    pub stage: Option<String>,
    /// Start of the current stage, RFC 3339; `null` if the job is not running or no stage has
    /// started.
    pub stage_started_at: Option<String>,
    /// Position of a queued job in the queue, 1 being next; `null` for other jobs. A job that waits
    /// for another attempt keeps its position and may be overtaken.
    pub queue_position: Option<u32>,
    /// Waiting jobs with a higher priority start first.
    pub priority: i64,
    /// What a worker must have to run this queued job; `null` if any worker can.
    pub waits_for: Option<String>,
    /// Why no connected worker can run this queued job, and what to start; `null` if one can.
    pub no_worker: Option<String>,
    /// Current or last round, from 1; 0 before the first.
    pub round: u32,
    /// Number of planned rounds.
    pub rounds: u32,
    /// Finished share of the expected work, 0 to 1.
    pub progress: f64,
    /// Training speed while the job trains, steps per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps_per_second: Option<f64>,
    /// Estimated seconds left while the job runs; absent where nothing is known, or it takes longer
    /// than estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eta_seconds: Option<f64>,
    /// Why the job failed.
    pub error: Option<JobError>,
    /// The photographs in groups that clearly match one another, if too few poses were found and
    /// not all photographs do; absent in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = of_overlap)]
    pub overlap: Option<Overlap>,
    /// Warnings about the whole capture.
    #[schema(schema_with = warnings)]
    pub warnings: Vec<CaptureWarning>,
    /// Delivered round of a finished job.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub best_round: Option<u32>,
    /// How the delivered round compares with photographs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub score: Option<Score>,
    /// Whether cancellation was requested.
    pub cancel_requested: bool,
    /// Number of attempts started.
    pub attempts: u32,
    /// Name of the preset.
    pub preset: String,
    /// All options.
    #[schema(value_type = Object)]
    pub options: Value,
    /// The detail that the training machine chose for `detail=auto`; absent before it has chosen,
    /// and if the options name the detail.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detail: Option<ChosenDetail>,
    /// Duration of every finished stage.
    pub stages: Vec<StageTime>,
    /// Time of creation, RFC 3339.
    pub created_at: String,
    /// Start of the first attempt, RFC 3339.
    pub started_at: Option<String>,
    /// Time at which the job ended, RFC 3339.
    pub finished_at: Option<String>,
    /// Whether the job is exempt from automatic deletion.
    pub pinned: bool,
    /// Time at which the job is deleted, RFC 3339.
    pub expires_at: Option<String>,
}

/// The detail that a machine has chosen.
#[derive(Debug, Serialize, ToSchema)]
pub struct ChosenDetail {
    /// `standard` or `high`.
    pub level: String,
    /// The fact about the device that decided it.
    pub because: String,
}

/// How a result compares with photographs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Score {
    /// `gt`: ground truth, which tells quality; `enhanced`: the brightened photographs, which tells
    /// agreement alone.
    #[schema(schema_with = of_reference)]
    pub reference: Reference,
    /// The views that count: those held out from training, if there are any.
    #[schema(schema_with = of_split)]
    pub split: Split,
    /// Mean PSNR after a per-channel colour fit, dB.
    pub psnr_cc_db: f64,
    /// Mean SSIM; absent without ground truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ssim: Option<f64>,
}

fn of_overlap() -> Ref {
    Ref::from_schema_name("Overlap")
}

fn of_reference() -> Ref {
    Ref::from_schema_name("Reference")
}

fn of_split() -> Ref {
    Ref::from_schema_name("Split")
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

/// The duration of a stage.
#[derive(Debug, Serialize, ToSchema)]
pub struct StageTime {
    /// Name of the stage.
    pub stage: String,
    /// Round, from 1; 0 for the poses.
    pub round: u32,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// A page of jobs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Jobs {
    /// The jobs, newest first.
    pub jobs: Vec<Job>,
    /// `cursor` of the next page, if there is one.
    pub next_cursor: Option<String>,
}

impl Job {
    pub fn from_details(job: JobDetails, crew: Option<&Crew>) -> Self {
        let JobDetails { row, warnings, stages, queue_position, stage_started_at, score, overlap } =
            job;
        Self {
            warnings: warnings
                .into_iter()
                .map(|warning| CaptureWarning { code: warning.code, message: warning.message })
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
            no_worker: crew.and_then(|crew| no_worker(&row, crew)),
            id: row.id,
            name: row.name,
            tags: row.tags,
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
            overlap,
            best_round: row.best_round,
            score: score.map(|score| Score {
                reference: score.reference,
                split: score.split,
                psnr_cc_db: score.psnr_cc_db,
                ssim: score.ssim,
            }),
            cancel_requested: row.cancel_requested,
            attempts: row.attempts,
            preset: row.preset,
            options: row.options,
            detail: row.detail.map(|detail| ChosenDetail {
                level: detail.level.name().to_owned(),
                because: detail.because,
            }),
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

/// Why no worker can run a queued job.
fn no_worker(row: &JobRow, crew: &Crew) -> Option<String> {
    crew.lacks(&row.needs).filter(|_| row.state == JobState::Queued)
}

/// RFC 3339 in UTC.
pub(super) fn time(milliseconds: i64) -> String {
    jiff::Timestamp::from_millisecond(milliseconds).unwrap_or_default().to_string()
}
