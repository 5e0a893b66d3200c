//! Renaming a job.

use std::sync::Arc;

use axum::extract::{Path, State};
use serde::Deserialize;
use utoipa::ToSchema;

use super::extract::Json;
use super::jobs::told;
use super::problem::Problem;
use super::shapes::Job;
use super::upload::check_name;
use crate::app::App;

/// The new name of a job.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenameJob {
    /// Name of the job.
    #[schema(min_length = 1, max_length = 200)]
    name: String,
}

/// Renames a job.
#[utoipa::path(patch, path = "/v1/jobs/{id}", operation_id = "rename_job",
    tag = "jobs", params(("id" = String, Path)), request_body = RenameJob,
    responses(
        (status = 200, description = "The job with its name", body = Job),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid name", body = Problem, content_type = "application/problem+json")))]
pub async fn rename(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Json(body): Json<RenameJob>,
) -> Result<axum::Json<Job>, Problem> {
    check_name(&body.name)?;
    if body.name.is_empty() {
        return Err(Problem::unprocessable("bad_input", "The name is empty.").pointer("/name"));
    }
    app.store.rename_job(&id, &body.name).await?;
    Ok(axum::Json(told(&app, &id).await?))
}
