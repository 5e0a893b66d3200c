//! `/v1/workers`: the worker machines of a shared deployment.

use std::sync::Arc;

use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::problem::Problem;
use super::shapes::time;
use crate::app::App;
use crate::store::{About, WorkerRow};

/// A machine that runs jobs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Worker {
    /// Name that stays the same after a restart.
    id: String,
    #[serde(flatten)]
    about: About,
    /// `works`; `stops` once it accepts no more jobs; `lost` once it was silent for longer than a
    /// lease and its jobs go to other workers.
    state: &'static str,
    /// Time of its start, RFC 3339.
    started_at: String,
    /// Time of its last report, RFC 3339.
    seen_at: String,
    /// Jobs that it runs.
    running: Vec<Running>,
}

/// A job that a worker runs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Running {
    /// ID of the job.
    job_id: String,
    /// Training speed while the job trains, steps per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    steps_per_second: Option<f64>,
}

/// The workers that reported within the last 24 hours.
#[derive(Debug, Serialize, ToSchema)]
pub struct Workers {
    /// Time of the database, to which the workers' times refer, RFC 3339.
    now: String,
    /// The workers, sorted by name; empty if the server works alone.
    workers: Vec<Worker>,
}

/// Lists the workers and the jobs that they run.
#[utoipa::path(get, path = "/v1/workers", operation_id = "list_workers", tag = "health",
    responses((status = 200, description = "The workers", body = Workers)))]
pub async fn list(State(app): State<Arc<App>>) -> Result<axum::Json<Workers>, Problem> {
    let now = app.store.now().await?;
    let workers = app.store.workers().await?;
    let workers = workers.into_iter().map(|row| worker(row, now - app.limits.lease_ms())).collect();
    Ok(axum::Json(Workers { now: time(now), workers }))
}

fn worker(row: WorkerRow, lost_before: i64) -> Worker {
    Worker {
        id: row.id,
        about: row.about,
        state: match row.draining {
            _ if row.seen_at < lost_before => "lost",
            true => "stops",
            false => "works",
        },
        started_at: time(row.started_at),
        seen_at: time(row.seen_at),
        running: row
            .running
            .into_iter()
            .map(|(job_id, steps_per_second)| Running { job_id, steps_per_second })
            .collect(),
    }
}
