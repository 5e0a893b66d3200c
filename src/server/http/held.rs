//! An upload in pieces, from whoever has it.

use axum::http::StatusCode;

use super::problem::Problem;
use crate::app::App;
use crate::holders::Hold;

/// The upload for oneself: whoever writes to it is told to stop, and has let go.
///
/// # Errors
/// 423 when they do not.
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
