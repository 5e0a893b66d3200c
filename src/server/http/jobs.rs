//! `/v1/jobs`.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{DefaultBodyLimit, Extension, FromRequest, Path, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use fled_core::plain::is_plain;
use serde::Deserialize;
use serde_json::{Map, Number, Value};
use utoipa::{IntoParams, ToSchema};

use super::SMALL;
use super::access::Visitor;
use super::extract::{Json, Query, is_json, parsed, typed};
use super::lookup::find;
use super::order::Order;
use super::page::{id, page_size};
use super::priority::Priority;
use super::problem::Problem;
use super::quota::bytes_left;
use super::room::{check_room, over_quota_jobs, queue_full};
use super::shapes::{Job, Jobs, report};
use super::texts::{check_text, check_value};
use super::upload::{self, OPTIONS, Upload};
use super::uploaded::{self, JobOfUploads};
use crate::app::App;
use crate::app::crew::Crew;
use crate::error::ServerError;
use crate::files::remove;
use crate::store::state::JobState;
use crate::store::{CaptureRow, Creation, JobDetails, JobFilter, JobRow};

/// How long a cancellation waits for the job to end before it responds.
const CANCEL_PATIENCE: Duration = Duration::from_millis(2500);

/// A job to create.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CreateJob {
    /// ID of an existing capture.
    capture_id: String,
    /// `auto` (default), `preview`, `standard`, `high` or `paper`.
    preset: Option<String>,
    /// Options that override the preset's; see `/v1/options`.
    #[serde(default)]
    #[schema(value_type = Object)]
    options: Map<String, Value>,
    /// Name of the job; the capture's name by default.
    name: Option<String>,
    /// From -100 to 100, 0 by default: waiting jobs with a higher priority start first. Above 0
    /// requires `admin` if the server has tokens.
    #[schema(value_type = Option<i32>, minimum = -100, maximum = 100)]
    priority: Option<Number>,
}

/// A job of an existing capture, or of finished uploads.
#[derive(ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "it describes what is distinguished by its fields")]
pub enum JobOrder {
    /// A job of an existing capture.
    OfCapture(CreateJob),
    /// A job of finished uploads.
    OfUploads(JobOfUploads),
}

/// A capture and a job as one form.
#[derive(ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "it describes what is read part by part")]
pub struct JobForm {
    /// Photographs, one ZIP file, or one video (MP4, MOV).
    #[schema(value_type = Vec<String>, format = Binary, min_items = 1)]
    images: Vec<Vec<u8>>,
    /// Ground truth with the same file names.
    #[schema(value_type = Option<Vec<String>>, format = Binary)]
    gt: Option<Vec<Vec<u8>>>,
    /// `transforms.json`, `poses_bounds.npy`, or the files of a COLMAP model.
    #[schema(value_type = Option<Vec<String>>, format = Binary)]
    poses: Option<Vec<Vec<u8>>>,
    /// Name of the capture and the job.
    #[schema(max_length = 200)]
    name: Option<String>,
    /// Number of photographs to take from a video, 3 to 500; 40 by default.
    frames: Option<String>,
    /// `auto` (default), `preview`, `standard`, `high` or `paper`.
    preset: Option<String>,
    /// Options that override the preset's, as a JSON object.
    options: Option<String>,
    /// From -100 to 100, 0 by default. Above 0 requires `admin` if the server has tokens.
    priority: Option<String>,
}

/// Which jobs to list.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ListQuery {
    /// Only jobs in this state.
    state: Option<JobState>,
    /// Only jobs of this capture.
    capture_id: Option<String>,
    /// Only the job that a request with this `Idempotency-Key` created.
    idempotency_key: Option<String>,
    /// Maximum number of results; 50 by default.
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Creates a job.
///
/// JSON names an existing capture or finished uploads; a multipart form creates capture and job in
/// one call.
#[utoipa::path(post, path = "/v1/jobs", operation_id = "create_job", tag = "jobs",
    params(("Idempotency-Key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[\\x20-\\x7e]+$", description = "Repeating a request with the same key returns the same job")),
    request_body(content(
        (JobOrder = "application/json"),
        (JobForm = "multipart/form-data"))),
    responses(
        (status = 202, description = "Accepted and stored on disk", body = Job, headers(("Location" = String))),
        (status = 404, description = "Capture or upload not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "An upload is not finished", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Unknown option, invalid value, or too few usable photographs", body = Problem, content_type = "application/problem+json")))]
pub async fn create(
    State(app): State<Arc<App>>,
    Extension(visitor): Extension<Visitor>,
    mut request: Request,
) -> Result<Response, Problem> {
    let key = idempotency_key(request.headers(), &visitor)?;
    let creation = if upload::is_multipart(request.headers()) {
        from_upload(&app, request, key.as_deref(), visitor.clone()).await?
    } else if !is_json(request.headers()) {
        return Err(upload::other_type());
    } else {
        // Uploads stream and are counted elsewhere; JSON is read into memory.
        DefaultBodyLimit::max(SMALL).apply(&mut request);
        let Json(body) = Json::<Map<String, Value>>::from_request(request, &app).await?;
        if body.contains_key("uploads") {
            let body: JobOfUploads = typed(body.into())?;
            uploaded::create_job(&app, body, key.as_deref(), visitor.clone()).await?
        } else {
            from_json(&app, &typed(body.into())?, key.as_deref(), &visitor).await?
        }
    };
    let (row, replayed) = match creation {
        Creation::Created(row) => (row, false),
        Creation::Replayed(row) => (row, true),
        Creation::KeyReused => {
            return Err(Problem::unprocessable(
                "key_reused",
                "This `Idempotency-Key` was used for a different request.",
            )
            .hint("Use a new key for a new job."));
        }
        Creation::QueueFull => return Err(queue_full()),
        Creation::OverQuota => return Err(over_quota_jobs(&visitor)),
    };
    let location = format!("/v1/jobs/{}", row.id);
    let job = load_job(&app, &row.id).await?;
    let mut response =
        (StatusCode::ACCEPTED, [(header::LOCATION, location)], axum::Json(job)).into_response();
    if replayed {
        response.headers_mut().insert("idempotent-replayed", HeaderValue::from_static("true"));
    }
    Ok(response)
}

async fn from_json(
    app: &App,
    body: &CreateJob,
    key: Option<&str>,
    visitor: &Visitor,
) -> Result<Creation, Problem> {
    // An accepted job must be stored: one that the disk cannot hold is refused now.
    upload::check_space(app)?;
    if !is_known(app, key).await? {
        bytes_left(app, visitor).await?;
    }
    if let Some(name) = &body.name {
        upload::check_name(name)?;
    }
    let capture = seen_capture(app, &body.capture_id, visitor).await?;
    let capture = capture.ok_or_else(|| Problem::not_found("capture").pointer("/capture_id"))?;
    let priority = Priority::asked(body.priority.as_ref(), visitor)?;
    let options = priority.beside(&body.options);
    let parts = [
        &body.capture_id,
        body.preset.as_deref().unwrap_or_default(),
        &options,
        body.name.as_deref().unwrap_or_default(),
    ];
    let fingerprint = blake3::hash(parts.join("\n").as_bytes()).to_hex().to_string();
    let order = Order::new(app, body.preset.as_deref(), &body.options, priority).await?;
    order.check_views(&report(&capture))?;
    let job = order.job(
        app,
        &capture.id,
        body.name.as_deref().filter(|name| !name.is_empty()).unwrap_or(&capture.name),
    )?;
    let made = app.store.create_job(&job, key, &fingerprint, visitor.room(app.limits.queue)).await;
    made.map_err(not_made)
}

/// The capture, unless it has another owner: that is reported as not found. A job belongs to its
/// capture's owner.
pub(super) async fn seen_capture(
    app: &App,
    id: &str,
    visitor: &Visitor,
) -> Result<Option<CaptureRow>, Problem> {
    let capture = app.store.capture(id).await?;
    Ok(capture.filter(|capture| {
        let only = visitor.sees_only();
        only.is_none() || capture.owner.as_deref() == only
    }))
}

/// Why a job was not created: its capture may have been deleted since the check.
fn not_made(error: ServerError) -> Problem {
    match error.is_of_a_name() {
        true => Problem::not_found("capture"),
        false => error.into(),
    }
}

async fn from_upload(
    app: &Arc<App>,
    request: Request,
    key: Option<&str>,
    visitor: Visitor,
) -> Result<Creation, Problem> {
    // Check before gigabytes are sent; a repeated request has its job and needs no room.
    let most = if is_known(app, key).await? {
        None
    } else {
        check_room(app, &visitor).await?;
        bytes_left(app, &visitor).await?
    };
    let fields = ["name", "frames", "preset", OPTIONS, "priority"];
    let upload = upload::receive(app, request, &fields, most).await?;
    let options = options_of(&upload)?;
    let preset = upload.fields.get("preset").cloned().filter(|preset| !preset.is_empty());
    let fingerprint = upload.fingerprint.clone();
    let priority = Priority::field(upload.fields.get("priority"), &visitor)?;
    // Check options before the photographs, so that a typo is reported at once.
    let order = Order::new(app, preset.as_deref(), &options, priority).await?;
    let report = upload.examine(app).await?;
    order.check_views(&report)?;
    let (app, key) = (app.clone(), key.map(str::to_owned));
    upload::to_its_end(async move {
        let capture = upload.keep(&app, &report, &visitor).await?;
        let job = order.job(&app, &capture.id, &capture.name)?;
        let room = visitor.room(app.limits.queue);
        let creation = app.store.create_job(&job, key.as_deref(), &fingerprint, room).await;
        // A replayed request already has a job with its own capture, and a refused one must not
        // leave a capture without a job: delete this copy.
        if !matches!(creation, Ok(Creation::Created(_)))
            && app.store.delete_capture(&capture.id).await?
        {
            remove(&app.data.capture(&capture.id)).await;
        }
        creation.map_err(not_made)
    })
    .await
}

/// The options in a form.
fn options_of(upload: &Upload) -> Result<Map<String, Value>, Problem> {
    let text = upload.fields.get(OPTIONS).map(String::as_str);
    let Some(text) = text.filter(|text| !text.trim().is_empty()) else {
        return Ok(Map::new());
    };
    let refused = |words: &str| {
        let detail = format!("`{OPTIONS}` {words}.");
        Problem::unprocessable("bad_input", detail).pointer("/options")
    };
    let options = parsed(text.as_bytes()).map_err(|words| refused(&words))?;
    check_value(&options, "/options")?;
    match options {
        Value::Object(options) => Ok(options),
        _ => Err(refused("must be a JSON object")),
    }
}

/// Returns whether a request with this key has created a job.
async fn is_known(app: &App, key: Option<&str>) -> Result<bool, Problem> {
    Ok(match key {
        Some(key) => app.store.knows_key(key).await?,
        None => false,
    })
}

/// The client's idempotency key, kept apart from those of other owners.
fn idempotency_key(headers: &HeaderMap, visitor: &Visitor) -> Result<Option<String>, Problem> {
    let Some(value) = headers.get("idempotency-key") else {
        return Ok(None);
    };
    match value.to_str() {
        Ok(key) if (1..=255).contains(&key.len()) && is_plain(key) => Ok(Some(own(key, visitor))),
        _ => Err(Problem::unprocessable(
            "bad_input",
            "`Idempotency-Key` must have 1 to 255 ASCII characters.",
        )),
    }
}

/// A key as stored: with the visitor's owner, apart from the same key of others.
fn own(key: &str, visitor: &Visitor) -> String {
    match visitor.owner() {
        // A key contains no line break.
        Some(owner) => format!("{owner}\n{key}"),
        None => key.to_owned(),
    }
}

/// Lists jobs, newest first.
#[utoipa::path(get, path = "/v1/jobs", operation_id = "list_jobs", tag = "jobs", params(ListQuery),
    responses(
        (status = 200, description = "One page of results", body = Jobs),
        (status = 422, description = "Invalid page parameters", body = Problem, content_type = "application/problem+json")))]
pub async fn list(
    State(app): State<Arc<App>>,
    Query(query): Query<ListQuery>,
    Extension(visitor): Extension<Visitor>,
) -> Result<axum::Json<Jobs>, Problem> {
    let limit = page_size(query.limit)?;
    let cursor = id(query.cursor.as_deref(), "cursor")?;
    let capture = id(query.capture_id.as_deref(), "capture_id")?;
    if let Some(key) = &query.idempotency_key {
        check_text(key, "/idempotency_key")?;
    }
    let key = query.idempotency_key.map(|key| own(&key, &visitor));
    let only = JobFilter {
        state: query.state,
        capture: capture.as_deref(),
        owner: visitor.sees_only(),
        key: key.as_deref(),
    };
    let found = app.store.jobs(only, limit + 1, cursor.as_deref());
    let mut found = found.await?;
    let more = found.len() > limit as usize;
    found.truncate(limit as usize);
    let last = found.last().filter(|_| more);
    let next_cursor = last.map(|job| job.row.id.clone());
    let crew = crew(&app, &found).await?;
    let jobs = found.into_iter().map(|job| Job::from_details(job, crew.as_ref())).collect();
    Ok(axum::Json(Jobs { jobs, next_cursor }))
}

/// Shows a job with its state, progress, warnings and error.
#[utoipa::path(get, path = "/v1/jobs/{id}", operation_id = "show_job",
    tag = "jobs", params(("id" = String, Path)),
    responses(
        (status = 200, description = "The job", body = Job),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn show(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<axum::Json<Job>, Problem> {
    Ok(axum::Json(load_job(&app, &id).await?))
}

/// Cancels a job and stops all of its processes within two seconds.
#[utoipa::path(post, path = "/v1/jobs/{id}/cancel", operation_id = "cancel_job",
    tag = "jobs", params(("id" = String, Path)),
    responses(
        (status = 202, description = "Cancelled, or being cancelled", body = Job),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job has already ended", body = Problem, content_type = "application/problem+json")))]
pub async fn cancel(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let row = find(&app, &id).await?;
    if app.store.request_cancel(&id).await?.is_none() {
        return Err(over(&row));
    }
    app.running.stop(&id);
    let mut versions = app.store.changes();
    let ended = async {
        while !find(&app, &id).await?.state.is_terminal() {
            if versions.changed().await.is_err() {
                break;
            }
        }
        Ok::<(), Problem>(())
    };
    // On a timeout the response shows the cancellation as requested.
    if let Ok(outcome) = tokio::time::timeout(CANCEL_PATIENCE, ended).await {
        outcome?;
    }
    let job = load_job(&app, &id).await?;
    Ok((StatusCode::ACCEPTED, axum::Json(job)).into_response())
}

/// Deletes a job that is not running, with its files.
#[utoipa::path(delete, path = "/v1/jobs/{id}", operation_id = "delete_job",
    tag = "jobs", params(("id" = String, Path)),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job is running", body = Problem, content_type = "application/problem+json")))]
pub async fn delete(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    find(&app, &id).await?;
    let videos = app.store.videos(&id).await?;
    if !app.store.delete_job(&id).await? {
        return Err(Problem::conflict("running", "The job is running.").hint("Cancel it first."));
    }
    for id in videos.iter().map(|video| &video.job.id).chain([&id]) {
        app.running.stop(id);
        remove(&app.data.job(id)).await;
    }
    Ok(StatusCode::NO_CONTENT)
}

pub(super) fn over(row: &JobRow) -> Problem {
    Problem::conflict("wrong_state", format!("The job is {}.", row.state.name())).hint(
        "Queued and running jobs can be cancelled. Failed and cancelled jobs can be retried, and \
             any ended job with other options.",
    )
}

/// Returns the job's JSON, or 404.
pub(super) async fn load_job(app: &App, id: &str) -> Result<Job, Problem> {
    let job = app.store.job_details(id).await?;
    let job = job.ok_or_else(|| Problem::not_found("job"))?;
    let crew = crew(app, std::slice::from_ref(&job)).await?;
    Ok(Job::from_details(job, crew.as_ref()))
}

/// The connected workers, if any of these jobs waits for one.
async fn crew(app: &App, jobs: &[JobDetails]) -> Result<Option<Crew>, Problem> {
    let waits = jobs.iter().any(|job| job.row.state == JobState::Queued);
    Ok(if waits { Some(Crew::of(app).await?) } else { None })
}
