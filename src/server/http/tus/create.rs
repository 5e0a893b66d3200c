//! Creation of uploads.

use std::sync::Arc;

use axum::body::{Body, HttpBody};
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode};
use tokio::fs::File;
use uuid::Uuid;

use super::fields::{CONCAT, DEFER_LENGTH, LENGTH, is_piece, number, other_type, unfit};
use super::metadata::Metadata;
use super::piece::{self, Piece, Stands, life};
use crate::app::App;
use crate::error::ServerError;
use crate::files::data::sync_directory;
use crate::files::remove;
use crate::http::access::Visitor;
use crate::http::problem::{Problem, disk_full, too_large};
use crate::http::quota::{bytes_left, over_quota};
use crate::http::room::check_room;
use crate::http::upload::to_its_end;
use crate::store::UploadRow;

/// Seconds after which there may be room for another upload.
const RETRY: u32 = 60;

/// A new upload.
#[derive(Debug)]
pub(super) struct Begun {
    pub(super) id: String,
    pub(super) offset: u64,
    pub(super) expires_at: i64,
}

/// Creates an upload, with its first piece if the request contains one.
///
/// # Errors
/// 400 for header fields that cannot be read, 422 for unsupported values, 413, 429, 503 and 507 if
/// there is no room, and the errors of the first piece. On an error no upload is created.
pub(super) async fn begin(
    app: &Arc<App>,
    visitor: &Visitor,
    request: Request,
) -> Result<Begun, Problem> {
    let (parts, body) = request.into_parts();
    let length = length(&parts.headers)?;
    let metadata = Metadata::of(&parts.headers)?;
    let first = first(&parts.headers, body)?;
    if length > app.limits.max_upload_bytes {
        return Err(too_large("The upload is too large.")
            .hint("OPTIONS returns the largest size as `Tus-Max-Size`."));
    }
    if app.has_no_space_for(length) {
        return Err(disk_full());
    }
    if metadata.is_for_job {
        check_room(app, visitor).await?;
    }
    let row = UploadRow {
        id: Uuid::now_v7().to_string(),
        owner: visitor.owner().map(str::to_owned),
        filename: metadata.filename,
        metadata: metadata.sent,
        length,
        created_at: app.store.now().await?,
        expires_at: life(app).await?,
    };
    keep(app, visitor, &row).await?;
    let mut begun = Begun { id: row.id.clone(), offset: 0, expires_at: row.expires_at };
    if let Some(first) = first {
        let app = app.clone();
        let stands = to_its_end(async move { with_first(&app, &row, first).await }).await?;
        (begun.offset, begun.expires_at) = (stands.offset, stands.expires_at);
    }
    Ok(begun)
}

fn length(headers: &HeaderMap) -> Result<u64, Problem> {
    for (name, of) in [(DEFER_LENGTH, "Deferred lengths are"), (CONCAT, "Concatenation is")] {
        if headers.contains_key(&name) {
            return Err(unfit(format!("{of} not supported: `{name}`.")));
        }
    }
    number(headers, &LENGTH)
}

/// The piece in the body of a creation request.
fn first(headers: &HeaderMap, body: Body) -> Result<Option<Piece>, Problem> {
    if body.is_end_stream() {
        return Ok(None);
    }
    if !is_piece(headers) {
        return Err(other_type());
    }
    Ok(Some(Piece { offset: 0, body }))
}

/// Stores the upload: its empty file, then its row.
async fn keep(app: &App, visitor: &Visitor, row: &UploadRow) -> Result<(), Problem> {
    // Concurrent uploads of one owner are counted one after another.
    let _turn = match visitor.quota_bytes() {
        Some(_) => Some(app.keeping.lock().await),
        None => None,
    };
    let left = bytes_left(app, visitor).await?;
    if left.is_some_and(|left| row.length > left) {
        return Err(over_quota());
    }
    let path = app.data.upload(&row.id);
    let made = File::create_new(&path).await;
    made.map_err(ServerError::io(&path))?;
    let folder = app.data.uploads();
    let synced = tokio::task::spawn_blocking(move || {
        sync_directory(&folder).map_err(ServerError::io(&folder))
    });
    let kept = match synced.await.map_err(|_| Problem::internal())? {
        Ok(()) => app.store.insert_upload(row, app.limits.max_uploads).await,
        Err(error) => Err(error),
    };
    if !matches!(kept, Ok(true)) {
        remove(&path).await;
    }
    if kept? { Ok(()) } else { Err(too_many(app)) }
}

/// Adds the first piece. Other requests do not know the upload yet; if this fails, it is removed.
async fn with_first(app: &App, row: &UploadRow, first: Piece) -> Result<Stands, Problem> {
    let lock = app.upload_locks.take(&row.id, app.limits.takeover).await;
    let lock = lock.ok_or_else(Problem::internal)?;
    let added = piece::add(app, &lock, row, first).await;
    if added.is_err() {
        app.store.forget_upload(&row.id, None).await?;
        remove(&app.data.upload(&row.id)).await;
    }
    added.map_err(|problem| problem.hint("Nothing was stored. Start the upload again."))
}

fn too_many(app: &App) -> Problem {
    let most = app.limits.max_uploads;
    Problem::new(
        StatusCode::TOO_MANY_REQUESTS,
        "too_many_uploads",
        format!("You already have {most} uploads that no capture uses yet."),
    )
    .hint("Make captures of them or delete some. Each expires some time after its last byte.")
    .retry_after(RETRY)
}
