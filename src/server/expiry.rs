//! Deletes what the server keeps no longer, after it has told so for a while.

use crate::app::App;
use crate::error::Result;
use crate::removal::remove;

/// Marks what will go and deletes what was marked for long enough. Returns how much was deleted.
///
/// # Errors
/// When the database refuses.
pub async fn expire(app: &App) -> Result<usize> {
    let now = app.store.now().await?;
    let marked = app.store.mark_expiring(&app.config.retention, now).await;
    // Where nothing may be deleted any more, what was marked is not deleted either.
    if app.config.retention.is_off() {
        return marked.map(|()| 0);
    }
    // Deleting is what helps where the disk is too full to mark.
    let expired = app.store.delete_expired(now).await?;
    for id in &expired.jobs {
        tracing::info!(job = id, "deleted: it was kept as long as jobs are");
        app.videos.stop_all(id);
        remove(&app.data.job(id)).await;
    }
    for id in &expired.captures {
        tracing::info!(capture = id, "deleted: it was kept as long as captures are");
        remove(&app.data.capture(id)).await;
    }
    app.changed();
    marked?;
    Ok(expired.jobs.len() + expired.captures.len())
}
