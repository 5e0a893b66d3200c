//! Quotas of an owner's captures, results and uploads on disk.

use std::path::PathBuf;

use axum::http::StatusCode;

use super::access::Visitor;
use super::problem::Problem;
use crate::app::App;
use crate::error::ServerError;
use crate::files::data::bytes_below;

/// Bytes left in a visitor's quota; `None` if only the disk limits them.
///
/// # Errors
/// 507 if none are left.
pub(super) async fn bytes_left(app: &App, visitor: &Visitor) -> Result<Option<u64>, Problem> {
    bytes_left_beside(app, visitor, 0).await
}

/// Like [`bytes_left`], without counting `uploads` bytes of uploads that are about to be used.
///
/// # Errors
/// 507 if none are left.
pub(super) async fn bytes_left_beside(
    app: &App,
    visitor: &Visitor,
    uploads: u64,
) -> Result<Option<u64>, Problem> {
    let Some((owner, most)) = visitor.quota_bytes() else {
        return Ok(None);
    };
    let held = if app.blob_cache.blobs().is_some() {
        app.store.bytes_of(owner).await?
    } else {
        bytes_here(app, owner).await?
    };
    let held = held + app.store.bytes_of_uploads(owner).await?.saturating_sub(uploads);
    match most.checked_sub(held).filter(|left| *left > 0) {
        Some(left) => Ok(Some(left)),
        None => Err(over_quota()),
    }
}

/// Bytes of an owner's captures and results in the data directory.
async fn bytes_here(app: &App, owner: &str) -> Result<u64, Problem> {
    let (captures, jobs) = app.store.belongings(owner).await?;
    let captures = captures.iter().map(|id| app.data.capture(id));
    let folders: Vec<PathBuf> = captures.chain(jobs.iter().map(|id| app.data.job(id))).collect();
    let held = tokio::task::spawn_blocking(move || {
        folders.iter().try_fold(0, |sum, folder| {
            bytes_below(folder).map(|bytes| sum + bytes).map_err(ServerError::io(folder))
        })
    });
    Ok(held.await.map_err(|_| Problem::internal())??)
}

/// 507: existing or future data exceeds the owner's quota.
pub(super) fn over_quota() -> Problem {
    Problem::new(
        StatusCode::INSUFFICIENT_STORAGE,
        "quota_bytes",
        "Your captures, results and uploads would take more space than your token allows.",
    )
    .hint("Delete what you no longer need, or ask the server's administrator for more space.")
}
