//! `/v1/captures/{id}/photographs` and `thumbnails`: the pictures of a capture.

use std::io;
use std::path::Path as FilePath;
use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use fled_core::capture::write_unpacked;

use super::exports::{Pipe, body_of, turn};
use super::problem::Problem;
use super::sent::Sent;
use crate::app::App;
use crate::files::data;
use crate::sharing::{fetch_photographs, fetch_thumbnails};
use crate::validation::source;

/// Returns a small picture of a photograph, as it was taken: a JPEG.
#[utoipa::path(get, path = "/v1/captures/{id}/thumbnails/{*name}", operation_id = "show_thumbnail",
    tag = "captures",
    params(("id" = String, Path), ("name" = String, Path, description = "The photograph's name as assessed; may contain `/`")),
    responses(
        (status = 200, description = "The picture", body = serde_json::Value, content_type = "image/jpeg"),
        (status = 304, description = "Not modified"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn thumbnail(
    State(app): State<Arc<App>>,
    Path((id, name)): Path<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let row = app.store.capture(&id).await?.ok_or_else(|| Problem::not_found("capture"))?;
    fetch_thumbnails(&app, &row.id).await?;
    let file = data::thumbnail(&name);
    let etag = format!("\"{}\"", file.display());
    let path = app.data.capture(&row.id).join(file);
    let about = tokio::fs::metadata(&path).await;
    // A capture of an older build has no thumbnails.
    let bytes = about.map_err(|_| Problem::not_found("thumbnail"))?.len();
    Sent { path, bytes, etag, media_type: "image/jpeg" }.answer(&headers).await
}

/// Returns a photograph as it was uploaded.
///
/// One from a ZIP is unpacked while it is sent, so its length is unknown and ranges are not
/// supported.
#[utoipa::path(get, path = "/v1/captures/{id}/photographs/{*name}", operation_id = "show_photograph",
    tag = "captures",
    params(("id" = String, Path), ("name" = String, Path, description = "The photograph's name as assessed; may contain `/`")),
    responses(
        (status = 200, description = "The file", body = serde_json::Value, content_type = "*/*"),
        (status = 304, description = "Not modified"),
        (status = 404, description = "Not found, or never decoded", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "Too many files are being made", body = Problem, content_type = "application/problem+json")))]
pub async fn original(
    State(app): State<Arc<App>>,
    Path((id, name)): Path<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let row = app.store.capture(&id).await?.ok_or_else(|| Problem::not_found("capture"))?;
    fetch_photographs(&app, &row.id).await?;
    let folder = app.data.capture(&row.id);
    let missing = || Problem::not_found("photograph");
    let thumbnail = data::thumbnail(&name);
    let place = {
        let folder = folder.clone();
        tokio::task::spawn_blocking(move || data::photograph(&folder, &name)).await
    };
    let place = place.map_err(|_| Problem::internal())?.ok_or_else(missing)?;
    let media_type = media_type(&place);
    let stored = source(folder.clone());
    if stored == folder {
        let path = folder.join(&place);
        let bytes = tokio::fs::metadata(&path).await.map_err(|_| missing())?.len();
        let etag = format!("\"{}\"", thumbnail.with_extension("").display());
        return Sent { path, bytes, etag, media_type }.answer(&headers).await;
    }
    let turn = turn(&app)?;
    let body = body_of(move |pieces| {
        let _turn = turn;
        let mut pipe = io::BufWriter::new(Pipe(pieces));
        let written = write_unpacked(&stored, &place, &mut pipe).map_err(io::Error::other);
        let written = written.and_then(|()| io::Write::flush(&mut pipe));
        match written {
            Err(error) if !pieces.is_closed() => {
                tracing::error!(%error, capture = row.id, "a photograph was not sent whole");
                // If the client has disconnected, there is no receiver for the error.
                let _ = pieces.blocking_send(Err(io::Error::other("the photograph is cut short")));
            }
            _ => {}
        }
    });
    let headers = [
        (header::CONTENT_TYPE, media_type),
        (header::CONTENT_SECURITY_POLICY, "default-src 'none'; sandbox"),
    ];
    Ok((headers, body).into_response())
}

/// The media type of an image format that browsers display; others are downloaded.
fn media_type(file: &FilePath) -> &'static str {
    let extension = file.extension().unwrap_or_default().to_ascii_lowercase();
    match extension.to_str() {
        Some("jpg" | "jpeg" | "jpe" | "jfif" | "mpo") => "image/jpeg",
        Some("png") => "image/png",
        Some("webp") => "image/webp",
        _ => "application/octet-stream",
    }
}
