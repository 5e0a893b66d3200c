//! Writes a piece of an upload to disk.

use axum::body::{Body, HttpBody};
use axum::http::StatusCode;
use futures::StreamExt;
use tokio::fs::File;
use tokio::io::AsyncWriteExt;

use super::file;
use crate::app::App;
use crate::error::ServerError;
use crate::files::upload_locks::UploadLock;
use crate::http::problem::{Problem, disk_full, too_large};
use crate::store::UploadRow;

/// Bytes written between two checks of the free disk space.
const LOOK_AT_DISK: u64 = 32 << 20;

/// The data to add, and its offset.
pub(super) struct Piece {
    /// The end of the upload as the client knows it.
    pub(super) offset: u64,
    pub(super) body: Body,
}

/// The state of an upload.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stands {
    /// Bytes on the disk.
    pub(super) offset: u64,
    /// Milliseconds since 1970.
    pub(super) expires_at: i64,
}

/// Why reading the body ended.
enum Ended {
    Whole,
    TooLong,
    Broken(String),
    DiskFull,
    Wanted,
    Stopping,
}

/// Adds a piece to an upload that this request has locked. When this returns, with or without an
/// error, the data that counts is on disk and no more is written.
///
/// # Errors
/// 409 if the piece does not begin at the end of the stored data, 413 if it is longer than the
/// rest: then none of it is kept. 400 if the body is interrupted, 409 if another request takes
/// over, 507 if there is no space for more: then the received data is kept.
pub(super) async fn add(
    app: &App,
    lock: &UploadLock,
    row: &UploadRow,
    piece: Piece,
) -> Result<Stands, Problem> {
    let (file, begin) = file::open(app, row).await?;
    if piece.offset != begin {
        let detail = "The piece does not begin where the stored bytes end.";
        return Err(Problem::conflict("wrong_offset", detail)
            .hint("HEAD returns where the next piece begins."));
    }
    let announced = piece.body.size_hint();
    if announced.lower() > row.length.saturating_sub(begin) {
        return Err(beyond());
    }
    if announced.exact() == Some(0) {
        // The reported offset must be on disk, including data written by a killed server.
        file::sync(app, row, &file).await?;
        let expires_at = row.expires_at;
        let offset = begin;
        return Ok(Stands { offset, expires_at });
    }
    if app.has_no_space_for(announced.lower()) {
        return Err(disk_full());
    }
    let writer = Writer { app, row, file, begin, at: begin, looked: begin };
    writer.write(piece.body, lock).await
}

/// When an upload expires if its last byte arrives now, in milliseconds since 1970.
pub(super) async fn life(app: &App) -> crate::error::Result<i64> {
    let life = i64::try_from(app.limits.upload_life.as_millis()).unwrap_or(i64::MAX / 4);
    Ok(app.store.now().await? + life)
}

struct Writer<'a> {
    app: &'a App,
    row: &'a UploadRow,
    file: File,
    begin: u64,
    at: u64,
    looked: u64,
}

impl Writer<'_> {
    async fn write(mut self, body: Body, lock: &UploadLock) -> Result<Stands, Problem> {
        let mut ended = self.pour(body, lock).await;
        // Writes to this file may still be pending.
        if let Err(error) = self.file.flush().await {
            let path = self.app.data.upload(&self.row.id);
            ended = ended.and(Err(ServerError::io(&path)(error)));
        }
        if matches!(ended, Ok(Ended::TooLong)) {
            file::cut(self.app, self.row, &self.file, self.begin).await?;
        }
        file::sync(self.app, self.row, &self.file).await?;
        let offset = file::length(self.app, self.row, &self.file).await?;
        let expires_at = life(self.app).await?;
        let touched = self.app.store.touch_upload(&self.row.id, expires_at);
        if !touched.await? {
            return Err(Problem::not_found("upload"));
        }
        match ended? {
            Ended::Whole => Ok(Stands { offset, expires_at }),
            Ended::TooLong => Err(beyond()),
            Ended::Broken(error) => Err(broken(&error)),
            Ended::DiskFull => Err(disk_full()),
            Ended::Wanted => Err(taken_over()),
            Ended::Stopping => Err(stopping()),
        }
    }

    /// Reads until the body ends or another request wants the upload.
    async fn pour(&mut self, body: Body, lock: &UploadLock) -> Result<Ended, ServerError> {
        let mut body = body.into_data_stream();
        loop {
            let chunk = tokio::select! {
                biased;
                () = lock.wanted() => return Ok(Ended::Wanted),
                () = self.app.shutdown.cancelled() => return Ok(Ended::Stopping),
                chunk = body.next() => chunk,
            };
            let chunk = match chunk {
                None => return Ok(Ended::Whole),
                Some(Err(error)) => return Ok(Ended::Broken(error.to_string())),
                Some(Ok(chunk)) => chunk,
            };
            if chunk.len() as u64 > self.row.length.saturating_sub(self.at) {
                return Ok(Ended::TooLong);
            }
            let written = self.file.write_all(&chunk).await;
            if let Err(error) = written {
                return Err(ServerError::io(&self.app.data.upload(&self.row.id))(error));
            }
            self.at += chunk.len() as u64;
            if self.at - self.looked > LOOK_AT_DISK {
                self.looked = self.at;
                if self.app.is_disk_full() {
                    return Ok(Ended::DiskFull);
                }
            }
        }
    }
}

fn beyond() -> Problem {
    too_large("The piece is longer than the rest of the upload.").hint(
        "`Upload-Length` is the size of the whole file. HEAD returns how much of it is stored.",
    )
}

fn broken(error: &str) -> Problem {
    let detail = format!("The body was interrupted: {error}");
    Problem::new(StatusCode::BAD_REQUEST, "bad_request", detail)
        .hint("HEAD returns how much of it is stored.")
}

fn taken_over() -> Problem {
    let detail = "Another request has taken over this upload.";
    Problem::conflict("taken_over", detail).hint("HEAD returns where to continue.")
}

fn stopping() -> Problem {
    let detail = "The server is shutting down.";
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "stopping", detail)
        .hint("Try again. HEAD returns where to continue.")
        .retry_after(5)
}
