//! `/v1/jobs/{id}/pin`: exempts a job from automatic deletion.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};

use super::jobs::load_job;
use super::problem::Problem;
use super::shapes::Job;
use crate::app::App;

/// Pins a job, so that the server does not delete it automatically.
#[utoipa::path(put, path = "/v1/jobs/{id}/pin", operation_id = "pin_job",
    tag = "jobs", params(("id" = String, Path)),
    responses(
        (status = 200, description = "The pinned job", body = Job),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn pin(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<Json<Job>, Problem> {
    set(&app, &id, true).await
}

/// Unpins a job.
#[utoipa::path(delete, path = "/v1/jobs/{id}/pin", operation_id = "unpin_job",
    tag = "jobs", params(("id" = String, Path)),
    responses(
        (status = 200, description = "The unpinned job", body = Job),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn unpin(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<Json<Job>, Problem> {
    set(&app, &id, false).await
}

async fn set(app: &App, id: &str, pinned: bool) -> Result<Json<Job>, Problem> {
    app.store.pin_job(id, pinned).await?;
    Ok(Json(load_job(app, id).await?))
}
