//! Files of a job made on other machines, fetched before a handler reads them here.

use std::sync::Arc;

use axum::RequestExt;
use axum::extract::{MatchedPath, RawPathParams, Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::paths::{EXPORT, EXPORTS, VIDEO_FILE, VIDEOS};
use super::problem::Problem;
use crate::app::App;
use crate::sharing::fetch_job;

/// Routes that read the files of a job.
const OF_FILES: [&str; 10] = [
    "/v1/jobs/{id}/rounds",
    "/v1/jobs/{id}/live",
    "/v1/jobs/{id}/log",
    "/v1/jobs/{id}/render",
    "/v1/jobs/{id}/artifacts",
    "/v1/jobs/{id}/artifacts/{*name}",
    EXPORTS,
    EXPORT,
    VIDEOS,
    VIDEO_FILE,
];

/// Fetches the changed files of a job from a shared blob store.
pub(super) async fn bring(
    State(app): State<Arc<App>>,
    mut request: Request,
    next: Next,
) -> Response {
    if app.blob_cache.blobs().is_none() {
        return next.run(request).await;
    }
    let route = request.extensions().get::<MatchedPath>();
    let route = route.map_or("", MatchedPath::as_str).to_owned();
    if !OF_FILES.contains(&route.as_str()) {
        return next.run(request).await;
    }
    // A video is also a job.
    let name = if route == VIDEO_FILE { "video" } else { "id" };
    let Some(id) = param(&mut request, name).await else {
        return next.run(request).await;
    };
    if let Err(error) = fetch_job(&app, &id).await {
        return Problem::from(error).into_response();
    }
    next.run(request).await
}

async fn param(request: &mut Request, name: &str) -> Option<String> {
    let params = request.extract_parts::<RawPathParams>().await.ok()?;
    let (_, value) = params.iter().find(|(key, _)| *key == name)?;
    Some(value.to_owned())
}
