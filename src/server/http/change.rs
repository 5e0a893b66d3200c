//! Changes a job's name and tags.

use std::sync::Arc;

use axum::extract::{Path, State};
use serde::Deserialize;
use utoipa::ToSchema;

use super::extract::Json;
use super::jobs::load_job;
use super::problem::Problem;
use super::shapes::Job;
use super::upload::check_name;
use crate::app::App;

/// Maximum tags of a job.
const MOST_TAGS: usize = 20;
/// Maximum characters of a tag.
const LONGEST_TAG: usize = 50;

/// What is to change of a job; the rest stays.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ChangeJob {
    /// Name of the job.
    #[schema(min_length = 1, max_length = 200)]
    name: Option<String>,
    /// All its tags; each has 1 to 50 characters.
    #[schema(max_items = 20)]
    tags: Option<Vec<String>>,
}

/// Renames a job, and changes its tags.
#[utoipa::path(patch, path = "/v1/jobs/{id}", operation_id = "change_job",
    tag = "jobs", params(("id" = String, Path)), request_body = ChangeJob,
    responses(
        (status = 200, description = "The job as it is now", body = Job),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid name or tag", body = Problem, content_type = "application/problem+json")))]
pub async fn change(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Json(body): Json<ChangeJob>,
) -> Result<axum::Json<Job>, Problem> {
    if let Some(name) = &body.name {
        check_name(name)?;
        if name.is_empty() {
            let empty = Problem::unprocessable("bad_input", "The name is empty.");
            return Err(empty.pointer("/name"));
        }
    }
    let tags = body.tags.as_deref().map(distinct).transpose()?;
    app.store.change_job(&id, body.name.as_deref(), tags.as_deref()).await?;
    Ok(axum::Json(load_job(&app, &id).await?))
}

/// Trims the tags and removes duplicates, keeping their order.
fn distinct(tags: &[String]) -> Result<Vec<String>, Problem> {
    let mut kept: Vec<String> = Vec::new();
    for tag in tags.iter().map(|tag| tag.trim()) {
        if tag.is_empty() || tag.chars().count() > LONGEST_TAG {
            return Err(Problem::unprocessable("bad_input", "A tag is empty or too long.")
                .pointer("/tags")
                .hint(format!("A tag has 1 to {LONGEST_TAG} characters.")));
        }
        if !kept.iter().any(|known| known == tag) {
            kept.push(tag.to_owned());
        }
    }
    if kept.len() > MOST_TAGS {
        return Err(Problem::unprocessable("bad_input", "There are too many tags.")
            .pointer("/tags")
            .hint(format!("A job has at most {MOST_TAGS} tags.")));
    }
    Ok(kept)
}
