//! Frees what nobody names any more.
//!
//! Files and rows cannot change together: a server that dies between the two leaves files without
//! a row, never a row without files. They are looked for at the start and every hour.
//!
//! A database that was restored from an older copy names less than there is, too. So captures, jobs
//! and uploads without a row are kept aside for a while before they go.

mod leftovers;

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::app::App;
use crate::collector::collect;
use crate::copies::remove_unused;
use crate::error::{Result, ServerError};
use crate::expiry::expire;
use crate::store::Engine;
use crate::uploads::{expire_uploads, forget_lost};

pub use leftovers::{Ages, Named, Why, rules};

/// Between two sweeps.
pub const PERIOD: Duration = Duration::from_secs(3600);

/// What webhooks were told is known for so long, milliseconds.
pub const DELIVERIES_KEPT_MS: i64 = 30 * 24 * 3600 * 1000;

/// Copies that nothing has used for so long are removed.
const UNUSED: Duration = Duration::from_secs(7 * 24 * 3600);

/// How long things stay where nobody says otherwise.
pub const AGES: Ages = Ages {
    made: PERIOD,
    unnamed: Duration::from_secs(30 * 24 * 3600),
    poses: Duration::from_secs(30 * 24 * 3600),
    renders: None,
};

/// Sweeps now and then until the server stops. What all share is left to those who serve: a worker
/// knows nothing of what is to be kept.
pub async fn keep_sweeping(app: Arc<App>, serves: bool) {
    loop {
        if app.store.engine() == Engine::Postgres {
            remove_copies(&app).await;
        }
        tokio::select! {
            () = tokio::time::sleep(PERIOD) => {}
            () = app.shutdown.cancelled() => return,
        }
        if let Err(error) = sweep(&app, PERIOD).await {
            tracing::warn!(%error, "cannot look for files that nobody names");
        }
        if !serves {
            continue;
        }
        if let Err(error) = forget_deliveries(&app).await {
            tracing::warn!(%error, "cannot forget what webhooks were told");
        }
        if let Err(error) = expire(&app).await {
            tracing::warn!(%error, "cannot delete what is kept no longer");
        }
        if let Some(blobs) = app.mirror.blobs() {
            match collect(&app.store, blobs).await {
                Ok(0) => {}
                Ok(deleted) => tracing::info!(deleted, "blobs that no file has are gone"),
                Err(error) => tracing::warn!(%error, "cannot look for blobs that no file has"),
            }
        }
    }
}

async fn remove_copies(app: &App) {
    match remove_unused(app, UNUSED).await {
        Ok(0) => {}
        Ok(removed) => tracing::info!(removed, "copies that were not used for a week are gone"),
        Err(error) => tracing::warn!(%error, "cannot look for copies that are not used"),
    }
}

async fn forget_deliveries(app: &App) -> Result<()> {
    let told_until = app.store.now().await? - DELIVERIES_KEPT_MS;
    app.store.forget_deliveries(told_until).await.map(drop)
}

/// Moves captures, jobs and uploads that have no row aside, and removes uploads and renders that
/// came to nothing, old poses, and what has been aside for long. Only what has not changed for
/// `age`: what is being made has no row yet. Returns how many things were moved and removed.
///
/// # Errors
/// When the database or the data directory cannot be read.
pub async fn sweep(app: &Arc<App>, age: Duration) -> Result<usize> {
    // What is stored after this is younger than `age`; at the start nothing is stored meanwhile.
    let named = Named::in_store(&app.store).await?;
    let shared = app.clone();
    let swept = tokio::task::spawn_blocking(move || sweep_files(&shared, &named, age));
    let swept = swept.await.unwrap_or_else(|error| {
        Err(ServerError::Io {
            path: app.data.jobs(),
            source: io::Error::other(error),
        })
    })?;
    Ok(swept + expire_uploads(app).await? + forget_lost(app).await?)
}

fn sweep_files(app: &App, rows: &Named, age: Duration) -> Result<usize> {
    let ages = Ages { made: age, ..AGES };
    let uses = |path: &Path| app.uploads.uses(path);
    let mut swept = 0;
    for rule in rules(&app.data, rows, ages, Some(&uses)) {
        swept += rule.follow_all()?;
    }
    Ok(swept)
}
