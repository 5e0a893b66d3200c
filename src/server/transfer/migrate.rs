//! Migration from a data directory with SQLite to PostgreSQL and a blob store: first the files,
//! then all rows in one transaction, so that no row names a missing file.

use std::collections::HashMap;
use std::path::Path;

use fled_blobs::{Blobs, Kept, Seen, push};

use crate::config::Limits;
use crate::error::{Result, ServerError};
use crate::files::data::DataDir;
use crate::janitor::claim;
use crate::sharing::is_kept;
use crate::store::Store;
use crate::transfer::adoption::adopt_videos;
use crate::worker::{after_death, kill_orphans};

/// Totals of a migration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Migrated {
    /// Rows.
    pub rows: usize,
    /// Files of captures and jobs.
    pub files: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Uploads that are not part of a capture, which are not copied.
    pub uploads: usize,
}

/// Copies all rows of the data directory's database to the PostgreSQL at `database`, and its files
/// to the blob store `files`. Jobs that ran when their server was killed are queued again, as at
/// its next start; nothing else changes in the data directory.
///
/// # Errors
/// [`ServerError::DataInUse`] while a server uses the directory, [`ServerError::NotMoved`] if the
/// database or the blob store is not empty or files are missing; when something cannot be read or
/// written. The database then has no rows.
pub async fn migrate(data: &Path, database: &str, files: &str) -> Result<Migrated> {
    if database.starts_with("sqlite:") {
        let words = "--db names an SQLite file; use postgres://USER:PASSWORD@HOST/NAME";
        return Err(ServerError::NotMoved(words.to_owned()));
    }
    let data = DataDir::open(data)?;
    let source = Store::open(&data.database()).await?;
    let target = Store::at(database).await?;
    target.expect_no_rows().await?;
    let blobs = Blobs::open(files)?;
    blobs.check().await?;
    if !blobs.is_empty().await? {
        return Err(ServerError::NotMoved(format!(
            "{} has files already, from another service or an interrupted attempt: empty it or \
             use another one",
            blobs.location()
        )));
    }
    claim(&target, &blobs).await?;
    let settle = |deaths| after_death(&Limits::default(), deaths, false);
    kill_orphans(&source.release_all(settle).await?);
    adopt_videos(&source, &data).await?;
    let mut done = Migrated { uploads: source.ids("uploads").await?.len(), ..Migrated::default() };
    let of_captures = keep_captures(&source, &data, &blobs).await?;
    let of_jobs = keep_jobs(&source, &data, &blobs).await?;
    done.rows = target.copy_from(&source, &of_captures, &of_jobs).await?;
    for (_, file) in of_captures.iter().chain(&of_jobs) {
        done.files += 1;
        done.bytes += file.blob.bytes;
    }
    source.close().await;
    target.close().await;
    Ok(done)
}

/// Puts the files of all captures into the blob store.
async fn keep_captures(
    source: &Store,
    data: &DataDir,
    blobs: &Blobs,
) -> Result<Vec<(String, Kept)>> {
    let mut kept = Vec::new();
    for id in source.ids("captures").await? {
        if !source.capture_files(&id).await?.is_empty() {
            return Err(ServerError::NotMoved(format!(
                "the files of capture {id} are in a store already: only a service that keeps files \
                 in its data directory can be moved"
            )));
        }
        let files = keep(blobs, &data.capture(&id), &|_| true).await?;
        if files.is_empty() {
            return Err(ServerError::NotMoved(format!(
                "{} has no files of capture {id}: delete the capture at the server and try again",
                data.root().display()
            )));
        }
        kept.extend(files.into_iter().map(|file| (id.clone(), file)));
    }
    Ok(kept)
}

/// Puts the shared files of all jobs into the store.
async fn keep_jobs(source: &Store, data: &DataDir, blobs: &Blobs) -> Result<Vec<(String, Kept)>> {
    let mut kept = Vec::new();
    let jobs = source.ids("jobs").await?;
    let total = jobs.len();
    for (at, id) in jobs.into_iter().enumerate() {
        if at % 50 == 0 {
            tracing::info!("the files of {at} of {total} jobs are in the store");
        }
        let files = keep(blobs, &data.job(&id), &is_kept).await?;
        kept.extend(files.into_iter().map(|file| (id.clone(), file)));
    }
    Ok(kept)
}

async fn keep(
    blobs: &Blobs,
    folder: &Path,
    filter: &(dyn Fn(&str) -> bool + Send + Sync),
) -> Result<Vec<Kept>> {
    let pushed = push(blobs, folder, filter, &HashMap::new(), &mut Seen::default()).await?;
    if pushed.skipped > 0 {
        return Err(ServerError::NotMoved(format!(
            "{} has files that change, or whose names are not UTF-8",
            folder.display()
        )));
    }
    Ok(pushed.kept)
}
