//! `/v1/captures`.

use std::sync::Arc;

use axum::extract::{DefaultBodyLimit, Extension, FromRequest, Path, Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::SMALL;
use super::access::Visitor;
use super::extract::{Json, Query, is_json};
use super::page::{id, page_size};
use super::problem::Problem;
use super::quota::bytes_left;
use super::shapes::{Capture, Captures};
use super::upload::{self, Upload};
use super::uploaded::CaptureOfUploads;
use crate::app::App;
use crate::files::remove;

/// How to take an upload.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct CreateQuery {
    /// Assess the upload without keeping it. Present and empty, or `true`.
    dry_run: Option<String>,
}

/// A capture as a form.
#[derive(ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "it describes what is read part by part")]
pub struct CaptureForm {
    /// Photographs, one ZIP file, or one video (MP4, MOV).
    #[schema(value_type = Vec<String>, format = Binary, min_items = 1)]
    images: Vec<Vec<u8>>,
    /// Ground truth with the same file names.
    #[schema(value_type = Option<Vec<String>>, format = Binary)]
    gt: Option<Vec<Vec<u8>>>,
    /// `transforms.json`, `poses_bounds.npy`, or the files of a COLMAP model.
    #[schema(value_type = Option<Vec<String>>, format = Binary)]
    poses: Option<Vec<Vec<u8>>>,
    /// Name of the capture.
    #[schema(max_length = 200)]
    name: Option<String>,
    /// Number of photographs to take from a video, 3 to 500; 40 by default.
    frames: Option<String>,
}

/// Which captures to list.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ListQuery {
    /// Maximum number of results; 50 by default.
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Creates a capture from photographs, a ZIP file, a video or finished uploads.
///
/// A form has parts named `images` and, if wanted, `gt`, poses and `name`. JSON names finished
/// uploads.
#[utoipa::path(post, path = "/v1/captures", operation_id = "create_capture",
    tag = "captures", params(CreateQuery),
    request_body(content(
        (CaptureForm = "multipart/form-data"),
        (CaptureOfUploads = "application/json"))),
    responses(
        (status = 200, description = "The assessments, after a dry run", body = Capture),
        (status = 201, description = "Stored on disk", body = Capture),
        (status = 404, description = "Upload not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "An upload is not finished", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Too few usable photographs", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "Too many videos are being read", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "The disk is full", body = Problem, content_type = "application/problem+json")))]
pub async fn create(
    State(app): State<Arc<App>>,
    Query(query): Query<CreateQuery>,
    Extension(visitor): Extension<Visitor>,
    request: Request,
) -> Result<Response, Problem> {
    let upload = received(&app, request, &visitor).await?;
    let report = upload.examine(&app).await?;
    if query.dry_run.is_some_and(|value| value != "false") {
        let name = upload.fields.get("name").cloned().unwrap_or_default();
        return Ok(axum::Json(Capture {
            id: None,
            name,
            created_at: None,
            expires_at: None,
            report,
        })
        .into_response());
    }
    let row = upload::to_its_end(async move { upload.keep(&app, &report, &visitor).await }).await?;
    let location = format!("/v1/captures/{}", row.id);
    let body = axum::Json(Capture::from_row(row));
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], body).into_response())
}

/// Receives the upload of the request, or takes earlier uploads.
async fn received(
    app: &Arc<App>,
    mut request: Request,
    visitor: &Visitor,
) -> Result<Upload, Problem> {
    if is_json(request.headers()) {
        // Uploads stream and are counted elsewhere; JSON is read into memory.
        DefaultBodyLimit::max(SMALL).apply(&mut request);
        let Json(body) = Json::<CaptureOfUploads>::from_request(request, app).await?;
        return body.bring(app, visitor).await;
    }
    let most = bytes_left(app, visitor).await?;
    upload::receive(app, request, &["name", "frames"], most).await
}

/// Lists captures, newest first.
#[utoipa::path(get, path = "/v1/captures", operation_id = "list_captures",
    tag = "captures", params(ListQuery),
    responses(
        (status = 200, description = "One page of results", body = Captures),
        (status = 422, description = "Invalid page parameters", body = Problem, content_type = "application/problem+json")))]
pub async fn list(
    State(app): State<Arc<App>>,
    Query(query): Query<ListQuery>,
    Extension(visitor): Extension<Visitor>,
) -> Result<axum::Json<Captures>, Problem> {
    let limit = page_size(query.limit)?;
    let cursor = id(query.cursor.as_deref(), "cursor")?;
    let rows = app.store.captures(limit + 1, cursor.as_deref(), visitor.sees_only()).await?;
    let more = rows.len() > limit as usize;
    let captures: Vec<Capture> =
        rows.into_iter().take(limit as usize).map(Capture::from_row).collect();
    let next_cursor = captures.last().filter(|_| more).and_then(|last| last.id.clone());
    Ok(axum::Json(Captures { captures, next_cursor }))
}

/// Shows a capture and its assessments.
#[utoipa::path(get, path = "/v1/captures/{id}", operation_id = "show_capture",
    tag = "captures", params(("id" = String, Path)),
    responses(
        (status = 200, description = "The capture", body = Capture),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn show(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<axum::Json<Capture>, Problem> {
    let row = app.store.capture(&id).await?.ok_or_else(|| Problem::not_found("capture"))?;
    Ok(axum::Json(Capture::from_row(row)))
}

/// Deletes a capture that no job uses.
#[utoipa::path(delete, path = "/v1/captures/{id}", operation_id = "delete_capture",
    tag = "captures", params(("id" = String, Path)),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "A job uses the capture", body = Problem, content_type = "application/problem+json")))]
pub async fn delete(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let row = app.store.capture(&id).await?.ok_or_else(|| Problem::not_found("capture"))?;
    if !app.store.delete_capture(&row.id).await? {
        let is_there = app.store.capture(&row.id).await?.is_some();
        return Err(match is_there {
            true => Problem::conflict("in_use", "A job uses this capture.")
                .hint("Delete its jobs first."),
            false => Problem::not_found("capture"),
        });
    }
    remove(&app.data.capture(&row.id)).await;
    Ok(StatusCode::NO_CONTENT)
}
