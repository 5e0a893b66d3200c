//! `/v1/jobs/{id}/retry`: continues finished jobs.

use std::sync::Arc;

use axum::body::HttpBody;
use axum::extract::{Extension, FromRequest, Path, Request, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::access::Visitor;
use super::extract::Json;
use super::jobs::{load_job, over};
use super::lookup::find;
use super::order::Order;
use super::problem::Problem;
use super::quota::bytes_left;
use super::room::{over_quota_jobs, queue_full};
use super::shapes::{Job, report};
use super::upload;
use crate::app::App;
use crate::store::{Change, JobRow, Retry};

/// How to continue a job.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RetryJob {
    /// Options that override the job's; see `/v1/options`.
    #[serde(default)]
    #[schema(value_type = Object)]
    options: Map<String, Value>,
}

/// Queues an ended job again.
///
/// A failed or cancelled job continues from its finished work. With changed options any ended job
/// continues, and repeats only what those options affect.
#[utoipa::path(post, path = "/v1/jobs/{id}/retry", operation_id = "retry_job",
    tag = "jobs", params(("id" = String, Path)),
    request_body = Option<RetryJob>,
    responses(
        (status = 202, description = "Queued", body = Job),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job has not ended, or it has succeeded and no option changes", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Unknown option or invalid value", body = Problem, content_type = "application/problem+json")))]
pub async fn retry(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Extension(visitor): Extension<Visitor>,
    request: Request,
) -> Result<Response, Problem> {
    upload::check_space(&app)?;
    bytes_left(&app, &visitor).await?;
    let row = find(&app, &id).await?;
    let change = if request.body().is_end_stream() {
        None
    } else {
        let Json(body) = Json::<RetryJob>::from_request(request, &app).await?;
        changed(&app, &row, &body.options).await?
    };
    let room = visitor.room(app.limits.queue);
    match app.store.retry(&id, room, change.as_ref()).await? {
        Retry::Queued => {}
        Retry::OverQuota => return Err(over_quota_jobs(&visitor)),
        Retry::WrongState => return Err(over(&row)),
        Retry::QueueFull => return Err(queue_full()),
    }
    let job = load_job(&app, &id).await?;
    Ok((StatusCode::ACCEPTED, axum::Json(job)).into_response())
}

/// The changed options; `None` if nothing changes.
async fn changed(
    app: &App,
    row: &JobRow,
    options: &Map<String, Value>,
) -> Result<Option<Change>, Problem> {
    if options.is_empty() {
        return Ok(None);
    }
    let order = Order::again(app, row, options).await?;
    let capture = app.store.capture(&row.capture_id).await?;
    let capture = capture.ok_or_else(|| Problem::not_found("capture"))?;
    order.check_views(&report(&capture))?;
    if order.asks_for(&row.options) {
        return Ok(None);
    }
    let job = order.job(app, &capture.id, &row.name)?;
    Ok(Some(Change { options: job.options, rounds: job.rounds, needs: job.needs }))
}
