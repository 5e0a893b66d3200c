//! Uploads in pieces that go: by their age, or because their file is lost.

use std::io;

use crate::app::App;
use crate::error::{Result, ServerError};
use crate::removal::remove_file;
use crate::store::Engine;

/// Deletes uploads of which nothing has come for long. Returns how many.
///
/// # Errors
/// When the database refuses.
pub async fn expire_uploads(app: &App) -> Result<usize> {
    let now = app.store.now().await?;
    let mut gone = 0;
    for id in app.store.expired_uploads(now).await? {
        // A piece that has taken longer than that is no reason.
        if app.holders.has(&id) || !app.store.forget_upload(&id, Some(now)).await? {
            continue;
        }
        tracing::info!(upload = id, "deleted: nothing more of it came");
        remove_file(&app.data.upload(&id)).await;
        gone += 1;
    }
    Ok(gone)
}

/// Forgets uploads whose file is not there: a file is made before its row and goes after it.
/// Returns how many.
///
/// # Errors
/// When the database refuses or the folder cannot be read.
pub async fn forget_lost(app: &App) -> Result<usize> {
    if app.store.engine() == Engine::Postgres {
        // They may be another replica's; rows of those that are lost go with their time.
        return Ok(0);
    }
    let mut lost = 0;
    for id in app.store.ids("uploads").await? {
        let path = app.data.upload(&id);
        match tokio::fs::metadata(&path).await {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                tracing::warn!(upload = id, "forgotten: its file is not there");
                lost += usize::from(app.store.forget_upload(&id, None).await?);
            }
            Err(error) => return Err(ServerError::io(&path)(error)),
            Ok(_) => {}
        }
    }
    Ok(lost)
}
