//! `/v1/jobs/{id}/live`: a preview of a job's scene while it trains.

use std::io::ErrorKind;
use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::lookup::find;
use super::problem::Problem;
use super::sent::is_known;
use super::tus::Bytes;
use crate::app::App;
use crate::error::ServerError;
use crate::store::state::JobState;

/// Shows one view of the scene while the job trains.
///
/// The picture belongs to the last `view_seen` event, which names its view and step. There is a new
/// one about every ten seconds.
#[utoipa::path(get, path = "/v1/jobs/{id}/live", operation_id = "show_live_picture",
    tag = "results", params(("id" = String, Path)),
    responses(
        (status = 200, description = "The picture", body = Bytes, content_type = "image/jpeg"),
        (status = 204, description = "The job is not training now"),
        (status = 304, description = "Not modified"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn show(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let job = find(&app, &id).await?;
    let path = app.data.output(&id).work().live_picture();
    let nothing = || Ok(StatusCode::NO_CONTENT.into_response());
    // A preview left by a killed process is outdated.
    if job.state != JobState::Running {
        return nothing();
    }
    let picture = match tokio::fs::read(&path).await {
        Ok(picture) => picture,
        Err(error) if error.kind() == ErrorKind::NotFound => return nothing(),
        Err(error) => return Err(ServerError::io(&path)(error).into()),
    };
    let etag = format!("\"{}\"", &blake3::hash(&picture).to_hex()[..32]);
    let common = [(header::ETAG, etag.clone()), (header::CONTENT_TYPE, "image/jpeg".to_owned())];
    if is_known(&headers, &etag) {
        return Ok((StatusCode::NOT_MODIFIED, common).into_response());
    }
    Ok((common, picture).into_response())
}
