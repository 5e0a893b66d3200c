//! `/v1/jobs/{id}/priority`: changes the place of a job in the queue.

use std::sync::Arc;

use axum::extract::{Extension, Path, State};
use serde::Deserialize;
use serde_json::Number;
use utoipa::ToSchema;

use super::access::Visitor;
use super::extract::Json;
use super::jobs::load_job;
use super::lookup::find;
use super::priority::Priority;
use super::problem::Problem;
use super::shapes::Job;
use crate::app::App;

/// The priority of a job.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SetPriority {
    /// From -100 to 100: waiting jobs with a higher priority start first. Above 0 requires `admin`
    /// if the server has tokens.
    #[schema(value_type = i32, minimum = -100, maximum = 100)]
    priority: Number,
}

/// Sets the priority of a job.
///
/// A running job continues; its priority counts if it has to wait again.
#[utoipa::path(put, path = "/v1/jobs/{id}/priority", operation_id = "prioritize_job",
    tag = "jobs", params(("id" = String, Path)), request_body = SetPriority,
    responses(
        (status = 200, description = "The job with its priority", body = Job),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job has ended", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid priority", body = Problem, content_type = "application/problem+json")))]
pub async fn prioritize(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Extension(visitor): Extension<Visitor>,
    Json(body): Json<SetPriority>,
) -> Result<axum::Json<Job>, Problem> {
    find(&app, &id).await?;
    let priority = Priority::asked(Some(&body.priority), &visitor)?;
    if !app.store.prioritize_job(&id, priority.number()).await? {
        let row = find(&app, &id).await?;
        let detail = format!("The job is {} and no longer waits.", row.state.name());
        return Err(Problem::conflict("wrong_state", detail)
            .hint("Only queued and running jobs have a priority."));
    }
    Ok(axum::Json(load_job(&app, &id).await?))
}
