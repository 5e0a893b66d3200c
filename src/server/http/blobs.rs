//! `/v1/work/blobs`: the bytes of files, for workers that cannot reach the store themselves.

use std::sync::Arc;

use axum::body::{Body, HttpBody};
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use fled_blobs::{AGE, BlobError, Blobs, Found};
use futures::StreamExt;
use tokio::io::{AsyncWriteExt, BufWriter};

use super::problem::{Problem, disk_full, too_large};
use crate::app::App;
use crate::error::ServerError;

/// Bytes that are written at once.
const WRITE: usize = 1 << 20;
/// Between two looks at the free space of the disk, bytes.
const LOOK_AT_DISK: u64 = 32 << 20;

/// The bytes of a file. Who asks compares them with the digest.
#[utoipa::path(get, path = "/v1/work/blobs/{digest}", operation_id = "get_blob", tag = "work",
    params(("digest" = String, Path, description = "BLAKE3, 64 lower hexadecimal digits")),
    responses(
        (status = 200, description = "`Fled-Age` says how many seconds ago they were written",
            body = [u8], content_type = "application/octet-stream"),
        (status = 404, description = "There are none", body = Problem,
            content_type = "application/problem+json")))]
pub async fn get(
    State(app): State<Arc<App>>,
    Path(digest): Path<String>,
) -> Result<Response, Problem> {
    let read = store(&app)?.read(&digest).await.map_err(worded)?;
    let (found, pieces) = read.ok_or_else(nothing)?;
    Ok((about(found), Body::from_stream(pieces)).into_response())
}

/// Whether there is such a file.
#[utoipa::path(head, path = "/v1/work/blobs/{digest}", operation_id = "find_blob", tag = "work",
    params(("digest" = String, Path, description = "BLAKE3, 64 lower hexadecimal digits")),
    responses(
        (status = 200, description = "`Fled-Age` says how many seconds ago it was written"),
        (status = 404, description = "There is none")))]
pub async fn head(
    State(app): State<Arc<App>>,
    Path(digest): Path<String>,
) -> Result<Response, Problem> {
    let found = store(&app)?.find(&digest).await.map_err(worded)?;
    Ok((about(found.ok_or_else(nothing)?), Body::empty()).into_response())
}

/// Keeps the bytes of a file, if they are those that the digest is of.
#[utoipa::path(put, path = "/v1/work/blobs/{digest}", operation_id = "put_blob", tag = "work",
    params(("digest" = String, Path, description = "BLAKE3, 64 lower hexadecimal digits")),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses(
        (status = 204, description = "They are kept"),
        (status = 413, description = "They are too many", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "They have another digest", body = Problem,
            content_type = "application/problem+json"),
        (status = 507, description = "The disk is full", body = Problem,
            content_type = "application/problem+json")))]
pub async fn put(
    State(app): State<Arc<App>>,
    Path(digest): Path<String>,
    request: Request,
) -> Result<StatusCode, Problem> {
    let blobs = store(&app)?;
    let incoming = app.data.incoming();
    let folder = app.uploads.begin(&incoming);
    let folder = folder.map_err(ServerError::io(&incoming))?;
    let path = folder.path().join("blob");
    let received = receive(&app, request.into_body(), &path).await?;
    if received != digest {
        let detail = format!("What came has the digest {received} and not {digest}.");
        return Err(Problem::unprocessable("wrong_digest", detail)
            .hint("It broke off, or the file changed while it was sent: send it again."));
    }
    blobs.put(&path).await.map_err(worded)?;
    Ok(StatusCode::NO_CONTENT)
}

/// Writes what comes into a file; its digest.
async fn receive(app: &App, body: Body, path: &std::path::Path) -> Result<String, Problem> {
    let announced = body.size_hint().lower();
    if announced > app.limits.max_upload_bytes {
        return Err(too_large("The file is too large."));
    }
    if app.has_no_space_for(announced) {
        return Err(disk_full());
    }
    let file = tokio::fs::File::create_new(path).await;
    let mut file = BufWriter::with_capacity(WRITE, file.map_err(ServerError::io(path))?);
    let mut hasher = blake3::Hasher::new();
    let (mut bytes, mut looked) = (0, 0);
    let mut pieces = body.into_data_stream();
    while let Some(piece) = pieces.next().await {
        let piece = piece.map_err(|error| {
            let detail = format!("The file broke off: {error}.");
            Problem::new(StatusCode::BAD_REQUEST, "bad_request", detail)
        })?;
        bytes += piece.len() as u64;
        if bytes > app.limits.max_upload_bytes {
            return Err(too_large("The file is too large."));
        }
        if bytes - looked > LOOK_AT_DISK {
            looked = bytes;
            if app.is_disk_full() {
                return Err(disk_full());
            }
        }
        hasher.update(&piece);
        let written = file.write_all(&piece).await;
        written.map_err(ServerError::io(path))?;
    }
    file.flush().await.map_err(ServerError::io(path))?;
    Ok(hasher.finalize().to_hex().to_string())
}

fn store(app: &App) -> Result<&Blobs, Problem> {
    app.mirror.blobs().ok_or_else(nothing)
}

fn nothing() -> Problem {
    Problem::not_found("file")
}

fn about(found: Found) -> HeaderMap {
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_LENGTH, found.bytes.into());
    headers.insert(AGE, found.age.as_secs().into());
    headers
}

fn worded(error: BlobError) -> Problem {
    match error {
        BlobError::Digest(_) => Problem::unprocessable("bad_input", error.to_string()),
        error => ServerError::from(error).into(),
    }
}
