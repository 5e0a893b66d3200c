//! `/v1/workers`: the worker machines of a shared deployment.

use std::sync::Arc;

use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::problem::Problem;
use super::shapes::time;
use crate::app::App;
use crate::store::{About, WorkerRow};

/// A machine that works.
#[derive(Debug, Serialize, ToSchema)]
pub struct Worker {
    /// Its name for itself: the same after a restart.
    id: String,
    #[serde(flatten)]
    about: About,
    /// `works`; `stops` when it takes no more jobs; `lost` when it has not been heard of for longer
    /// than a lease, and its jobs are given to others.
    state: &'static str,
    /// RFC 3339.
    started_at: String,
    /// When it was last heard of: RFC 3339.
    seen_at: String,
    /// The jobs that it runs.
    running: Vec<Running>,
}

/// A job that a worker runs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Running {
    /// Which.
    job_id: String,
    /// Training speed, while it trains.
    #[serde(skip_serializing_if = "Option::is_none")]
    steps_per_second: Option<f64>,
}

/// All that were heard of within a day.
#[derive(Debug, Serialize, ToSchema)]
pub struct Workers {
    /// The database's clock, which all these times are by: RFC 3339.
    now: String,
    /// By name. Empty where the server works alone.
    workers: Vec<Worker>,
}

/// The machines that work, and what they do.
#[utoipa::path(get, path = "/v1/workers", operation_id = "list_workers", tag = "health",
    responses((status = 200, description = "All of them", body = Workers)))]
pub async fn list(State(app): State<Arc<App>>) -> Result<axum::Json<Workers>, Problem> {
    let now = app.store.now().await?;
    let workers = app.store.workers().await?;
    let workers = workers
        .into_iter()
        .map(|row| worker(row, now - app.limits.lease_ms()))
        .collect();
    Ok(axum::Json(Workers {
        now: time(now),
        workers,
    }))
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
            .map(|(job_id, steps_per_second)| Running {
                job_id,
                steps_per_second,
            })
            .collect(),
    }
}
