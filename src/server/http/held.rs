//! Exclusive access to resumable uploads.

use axum::http::StatusCode;

use super::problem::Problem;
use crate::app::App;
use crate::holders::Hold;

/// Locks an upload: asks its current writer to stop, and waits until it has.
///
/// # Errors
/// 423 if the writer does not stop.
pub(super) async fn hold(app: &App, id: &str) -> Result<Hold, Problem> {
    let hold = app.holders.take(id, app.limits.takeover).await;
    hold.ok_or_else(|| {
        Problem::new(
            StatusCode::LOCKED,
            "locked",
            "Another request still uses this upload.",
        )
        .hint("Try again in some seconds.")
        .retry_after(1)
    })
}
