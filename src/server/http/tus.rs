//! `/v1/uploads`: resumable uploads by the tus protocol 1.0.0 with its extensions creation,
//! creation-with-upload, expiration and termination.

mod create;
mod fields;
mod file;
mod metadata;
mod piece;

use std::sync::Arc;

use axum::extract::{Extension, Path, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use utoipa::ToSchema;

use self::fields::{
    EXPIRES, EXTENSION, LENGTH, MAX_SIZE, METADATA, METHOD_OVERRIDE, OFFSET, RESUMABLE, VERSION,
    VERSIONS, expires, is_piece, number,
};
use self::metadata::Metadata;
use self::piece::Piece;
use super::access::Visitor;
use super::paths::UPLOADS;
use super::problem::Problem;
use super::upload::to_its_end;
use crate::app::App;
use crate::files::remove;
use crate::files::upload_locks::UploadLock;
use crate::store::UploadRow;

/// Supported extensions of the protocol.
const EXTENSIONS: &str = "creation,creation-with-upload,expiration,termination";

/// The bytes of a file.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "it describes what is read as it comes")]
pub struct Bytes(Vec<u8>);

/// Adds the protocol version to every response about uploads, including errors.
pub(super) async fn mark(request: Request, next: Next) -> Response {
    let path = request.uri().path();
    let is_ours =
        path.strip_prefix(UPLOADS).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
    let mut answer = next.run(request).await;
    if is_ours {
        answer.headers_mut().insert(RESUMABLE, HeaderValue::from_static(VERSION));
    }
    answer
}

/// Refuses requests with another protocol version.
pub(super) async fn check_version(request: Request, next: Next) -> Response {
    let version = request.headers().get(RESUMABLE);
    let is_spoken = match *request.method() {
        Method::OPTIONS => true,
        // In any version, a POST to an upload is only an override of another method.
        Method::POST if request.uri().path() != UPLOADS => {
            overriding(request.headers()).is_none() || version.is_some_and(|v| v == VERSION)
        }
        _ => version.is_some_and(|version| version == VERSION),
    };
    if is_spoken {
        return next.run(request).await;
    }
    let problem = Problem::new(
        StatusCode::PRECONDITION_FAILED,
        "tus_version",
        "This server supports version 1.0.0 of the tus protocol.",
    );
    let hint = "Send `Tus-Resumable: 1.0.0`.";
    ([(VERSIONS, VERSION)], problem.hint(hint)).into_response()
}

/// Reads all tus header fields of a request, for fuzzers.
///
/// # Errors
/// 400 if a field cannot be read.
#[doc(hidden)]
pub fn read_headers(headers: &HeaderMap) -> Result<(), Problem> {
    let metadata = Metadata::of(headers);
    let numbers = [LENGTH, OFFSET].map(|name| number(headers, &name));
    is_piece(headers);
    metadata?;
    numbers.into_iter().try_for_each(|number| number.map(drop))
}

/// Describes the supported upload protocol.
#[utoipa::path(options, path = "/v1/uploads", operation_id = "upload_options", tag = "uploads",
    responses((status = 204, description = "The supported protocol", headers(
        ("Tus-Resumable" = String), ("Tus-Version" = String), ("Tus-Extension" = String),
        ("Tus-Max-Size" = u64)))))]
pub async fn options(State(app): State<Arc<App>>) -> Response {
    let headers: [(HeaderName, String); 3] = [
        (VERSIONS, VERSION.to_owned()),
        (EXTENSION, EXTENSIONS.to_owned()),
        (MAX_SIZE, app.limits.max_upload_bytes.to_string()),
    ];
    (StatusCode::NO_CONTENT, headers).into_response()
}

/// Describes the supported upload protocol, for an existing upload.
#[utoipa::path(options, path = "/v1/uploads/{id}", operation_id = "one_upload_options",
    tag = "uploads", params(("id" = String, Path)),
    responses((status = 204, description = "The supported protocol", headers(
        ("Tus-Resumable" = String), ("Tus-Version" = String), ("Tus-Extension" = String),
        ("Tus-Max-Size" = u64)))))]
pub async fn options_of_one(app: State<Arc<App>>) -> Response {
    options(app).await
}

/// Starts a resumable upload.
///
/// The body may hold the first piece.
#[utoipa::path(post, path = "/v1/uploads", operation_id = "create_upload", tag = "uploads",
    params(
        ("Tus-Resumable" = String, Header, pattern = "^1\\.0\\.0$", description = "1.0.0"),
        ("Upload-Length" = u64, Header, description = "Size of the file, bytes"),
        ("Upload-Metadata" = String, Header, max_length = 8192, description = "Comma-separated keys with values in base64; `filename` is required, and `for` set to `job` refuses the upload while there is no room for another job")),
    request_body(content = Option<Bytes>, content_type = "application/offset+octet-stream"),
    responses(
        (status = 201, description = "The upload was started", headers(("Location" = String),
            ("Upload-Offset" = u64), ("Upload-Expires" = String), ("Tus-Resumable" = String))),
        (status = 412, description = "Unsupported tus version; `Tus-Version` names the supported one", body = Problem, content_type = "application/problem+json", headers(("Tus-Version" = String))),
        (status = 503, description = "The upload is for a job, and too many jobs are waiting", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "The disk is full, or the quota is used up", body = Problem, content_type = "application/problem+json")))]
pub async fn create(
    State(app): State<Arc<App>>,
    Extension(visitor): Extension<Visitor>,
    request: Request,
) -> Result<Response, Problem> {
    let begun = create::begin(&app, &visitor, request).await?;
    let headers = [
        (header::LOCATION, format!("{UPLOADS}/{}", begun.id)),
        (OFFSET, begun.offset.to_string()),
        (EXPIRES, expires(begun.expires_at)),
    ];
    Ok((StatusCode::CREATED, headers).into_response())
}

/// Reports how much of an upload is stored.
///
/// A request that is sending a piece of it is stopped.
#[utoipa::path(head, path = "/v1/uploads/{id}", operation_id = "show_upload", tag = "uploads",
    params(("id" = String, Path),
        ("Tus-Resumable" = String, Header, pattern = "^1\\.0\\.0$", description = "1.0.0")),
    responses(
        (status = 200, description = "The number of stored bytes, in `Upload-Offset`", headers(("Upload-Offset" = u64),
            ("Upload-Length" = u64), ("Upload-Metadata" = String), ("Upload-Expires" = String),
            ("Cache-Control" = String), ("Tus-Resumable" = String))),
        (status = 404, description = "Not found, already used or expired"),
        (status = 412, description = "Unsupported tus version; `Tus-Version` names the supported one", headers(("Tus-Version" = String))),
        (status = 423, description = "Another request still holds the upload; try again")))]
pub async fn head(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let (row, offset) = to_its_end(async move {
        let (_lock, row) = taken(&app, &id).await?;
        let (file, offset) = file::open(&app, &row).await?;
        file::sync(&app, &row, &file).await?;
        Ok((row, offset))
    })
    .await?;
    let headers = [
        (OFFSET, offset.to_string()),
        (LENGTH, row.length.to_string()),
        (METADATA, row.metadata),
        (EXPIRES, expires(row.expires_at)),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ];
    Ok(headers.into_response())
}

/// Appends a piece to an upload.
///
/// Bytes that arrived before a connection broke are kept.
#[utoipa::path(patch, path = "/v1/uploads/{id}", operation_id = "continue_upload", tag = "uploads",
    params(("id" = String, Path),
        ("Tus-Resumable" = String, Header, pattern = "^1\\.0\\.0$", description = "1.0.0"),
        ("Upload-Offset" = u64, Header, description = "Where the piece begins: the number of bytes already stored")),
    request_body(content = Bytes, content_type = "application/offset+octet-stream"),
    responses(
        (status = 204, description = "Stored on disk", headers(("Upload-Offset" = u64),
            ("Upload-Expires" = String), ("Tus-Resumable" = String))),
        (status = 404, description = "Not found, already used or expired", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The piece does not begin where the stored bytes end, or another request has taken over", body = Problem, content_type = "application/problem+json"),
        (status = 412, description = "Unsupported tus version; `Tus-Version` names the supported one", body = Problem, content_type = "application/problem+json", headers(("Tus-Version" = String))),
        (status = 423, description = "Another request still holds the upload; try again", body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "The disk is full", body = Problem, content_type = "application/problem+json")))]
pub async fn patch(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    request: Request,
) -> Result<Response, Problem> {
    let (parts, body) = request.into_parts();
    if !is_piece(&parts.headers) {
        return Err(fields::other_type());
    }
    let piece = Piece { offset: number(&parts.headers, &OFFSET)?, body };
    let stands = to_its_end(async move {
        let (lock, row) = taken(&app, &id).await?;
        piece::add(&app, &lock, &row, piece).await
    })
    .await?;
    let headers = [(OFFSET, stands.offset.to_string()), (EXPIRES, expires(stands.expires_at))];
    Ok((StatusCode::NO_CONTENT, headers).into_response())
}

/// Deletes an upload.
#[utoipa::path(delete, path = "/v1/uploads/{id}", operation_id = "delete_upload", tag = "uploads",
    params(("id" = String, Path),
        ("Tus-Resumable" = String, Header, pattern = "^1\\.0\\.0$", description = "1.0.0")),
    responses(
        (status = 204, description = "Deleted", headers(("Tus-Resumable" = String))),
        (status = 404, description = "Not found, already used or expired", body = Problem, content_type = "application/problem+json"),
        (status = 412, description = "Unsupported tus version; `Tus-Version` names the supported one", body = Problem, content_type = "application/problem+json", headers(("Tus-Version" = String))),
        (status = 423, description = "Another request still holds the upload; try again", body = Problem, content_type = "application/problem+json")))]
pub async fn delete(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    to_its_end(async move {
        let (_lock, row) = taken(&app, &id).await?;
        if !app.store.forget_upload(&row.id, None).await? {
            return Err(unknown());
        }
        remove(&app.data.upload(&row.id)).await;
        Ok(StatusCode::NO_CONTENT)
    })
    .await
}

/// For clients that can send only GET and POST: the protocol uses the method in this header instead
/// of the request's own.
pub async fn by_override(
    app: State<Arc<App>>,
    id: Path<String>,
    request: Request,
) -> Result<Response, Problem> {
    match overriding(request.headers()) {
        Some(Method::HEAD) => head(app, id).await,
        Some(Method::PATCH) => patch(app, id, request).await,
        Some(Method::DELETE) => delete(app, id).await.map(IntoResponse::into_response),
        _ => {
            let problem = Problem::new(
                StatusCode::METHOD_NOT_ALLOWED,
                "method_not_allowed",
                "This endpoint does not support this method.",
            );
            let hint = "Send a piece with PATCH, or with POST and `X-HTTP-Method-Override: PATCH`.";
            let allowed = [(header::ALLOW, "HEAD,PATCH,DELETE,OPTIONS")];
            Ok((allowed, problem.hint(hint)).into_response())
        }
    }
}

fn overriding(headers: &HeaderMap) -> Option<Method> {
    let method = headers.get(METHOD_OVERRIDE)?;
    Method::from_bytes(method.as_bytes()).ok()
}

/// Locks an upload, and stops the request that uses it.
///
/// # Errors
/// 423 when that request does not release it.
pub(super) async fn lock(app: &App, id: &str) -> Result<UploadLock, Problem> {
    let lock = app.upload_locks.take(id, app.limits.takeover).await;
    lock.ok_or_else(|| {
        Problem::new(StatusCode::LOCKED, "locked", "Another request still uses this upload.")
            .hint("Try again in some seconds.")
            .retry_after(1)
    })
}

/// Takes over an upload. It is looked up after locking, because it may be deleted meanwhile.
async fn taken(app: &App, id: &str) -> Result<(UploadLock, UploadRow), Problem> {
    let lock = lock(app, id).await?;
    let row = app.store.upload(id).await?.ok_or_else(unknown)?;
    Ok((lock, row))
}

fn unknown() -> Problem {
    Problem::not_found("upload")
}
