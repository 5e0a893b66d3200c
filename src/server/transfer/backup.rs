//! Backup of a data directory in use, from which another server can be started.
//!
//! The database is copied first, as a snapshot, then the files that it names. Captures never
//! change, and neither do finished jobs. A job that is queued or running in the snapshot, or is
//! retried during the copy, has no files in the backup: it starts from scratch there. Uploads that
//! are not yet part of a capture are not copied.

use std::collections::{HashMap, HashSet};
use std::fs::{self, File};
use std::io;
use std::path::Path;

use crate::error::{Result, ServerError};
use crate::files::data::sync_directories;
use crate::store::{Attempted, Store};

/// Top-level entries of a job's folder that are not copied: novel views are rendered again on
/// demand, and change while the job does not.
const MADE_AGAIN: [&str; 1] = ["renders"];

/// Totals of a backup.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Backup {
    /// Captures.
    pub captures: usize,
    /// Jobs with their results.
    pub jobs: usize,
    /// Jobs that start from scratch in the backup.
    pub anew: usize,
    /// Bytes of files, without the database.
    pub bytes: u64,
}

/// Copies the data directory `data` to `to`, which must not exist or be empty.
///
/// # Errors
/// [`ServerError::Io`] or [`ServerError::Database`] when something cannot be read or written; `to`
/// is then incomplete and should be removed.
pub async fn backup(data: &Path, to: &Path) -> Result<Backup> {
    make_empty(to)?;
    let live = Store::as_it_is(&data.join("fled.db")).await?;
    live.copy_to(&to.join("fled.db")).await?;
    let copy = Store::open(&to.join("fled.db")).await?;
    // Pieces that arrive meanwhile would be missing, and videos can be made again on demand.
    copy.forget_uploads().await?;
    copy.forget_videos().await?;
    let mut done = Backup::default();
    let captures = copy.ids("captures").await?;
    let mut incomplete = HashSet::new();
    for id in &captures {
        match copied(data, to, &Path::new("captures").join(id))? {
            Some(bytes) => done.bytes += bytes,
            None => drop(incomplete.insert(id.clone())),
        }
    }
    let mut jobs = copy.attempted().await?;
    for (id, job) in &mut jobs {
        let folder = Path::new("jobs").join(id);
        if job.is_over {
            match copied(data, to, &folder)? {
                Some(bytes) => done.bytes += bytes,
                // A job cancelled before it began has no folder.
                None => job.is_over = !data.join(&folder).exists(),
            }
        }
    }
    // Entries deleted meanwhile may have been copied in part.
    let kept = live.ids("captures").await?;
    for id in &captures {
        if incomplete.contains(id) || !kept.contains(id) {
            copy.forget_capture(id).await?;
            remove(&to.join("captures").join(id))?;
        } else {
            done.captures += 1;
        }
    }
    let now = live.attempted().await?;
    done.anew = begin_anew(&copy, &jobs, &now, to).await?;
    done.jobs = copy.attempted().await?.len() - done.anew;
    copy.close().await;
    live.close().await;
    sync_directories(to).map_err(ServerError::io(to))?;
    Ok(done)
}

/// Ensures that jobs changed since the start of the copy are either complete or absent.
async fn begin_anew(
    copy: &Store,
    jobs: &HashMap<String, Attempted>,
    now: &HashMap<String, Attempted>,
    to: &Path,
) -> Result<usize> {
    let mut anew = 0;
    for (id, job) in jobs {
        let folder = to.join("jobs").join(id);
        match now.get(id) {
            Some(now) if now == job && job.is_over => continue,
            // A job whose capture was removed does not count.
            Some(_) => anew += usize::from(copy.begin_anew(id).await?),
            None => drop(copy.delete_job(id).await?),
        }
        remove(&folder)?;
    }
    Ok(anew)
}

fn remove(folder: &Path) -> Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(ServerError::io(folder)(error))
        }
        _ => Ok(()),
    }
}

fn make_empty(to: &Path) -> Result<()> {
    let make = || {
        fs::create_dir_all(to)?;
        match fs::read_dir(to)?.next() {
            None => Ok(()),
            Some(_) => Err(io::Error::other("it is not empty; a backup needs a new folder")),
        }
    };
    make().map_err(ServerError::io(to))
}

/// Copies a folder and returns its bytes; `None` if the folder does not exist or has been deleted
/// meanwhile.
fn copied(data: &Path, to: &Path, folder: &Path) -> Result<Option<u64>> {
    let (from, to) = (data.join(folder), to.join(folder));
    match copy_tree(&from, &to, &MADE_AGAIN) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(ServerError::io(&from)(error)),
    }
}

/// Copies everything except top-level directories named in `but`.
fn copy_tree(from: &Path, to: &Path, but: &[&str]) -> io::Result<u64> {
    fs::create_dir_all(to)?;
    let mut bytes = 0;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let name = entry.file_name();
        let (from, to) = (entry.path(), to.join(&name));
        if entry.file_type()?.is_dir() {
            if !but.iter().any(|but| name == *but) {
                bytes += copy_tree(&from, &to, &[])?;
            }
        } else {
            bytes += fs::copy(&from, &to)?;
            File::open(&to)?.sync_all()?;
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::{create, keep_capture, room};

    async fn with_cancelled_jobs(path: &Path, ids: &[&str]) -> Store {
        let store = Store::open(path).await.expect("open");
        keep_capture(&store, "c", None, &[]).await;
        for id in ids {
            create(&store, id).await;
            store.request_cancel(id).await.expect("cancelled");
        }
        store
    }

    #[tokio::test]
    async fn jobs_changed_during_a_backup_are_complete_or_absent() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let path = dir.path();
        let ids = ["stays", "again", "goes"];
        let live = with_cancelled_jobs(&path.join("live.db"), &ids).await;
        live.copy_to(&path.join("copy.db")).await.expect("copied");
        let copy = Store::open(&path.join("copy.db")).await.expect("open");
        let jobs = copy.attempted().await.expect("jobs");
        for id in ids {
            fs::create_dir_all(path.join("jobs").join(id).join("output")).expect("made");
        }
        live.retry("again", room(9), None).await.expect("queued");
        live.delete_job("goes").await.expect("deleted");
        let now = live.attempted().await.expect("jobs");
        let anew = begin_anew(&copy, &jobs, &now, path).await.expect("done");
        assert_eq!(anew, 1);
        assert!(!copy.begin_anew("no-job").await.expect("asked"));
        let state = async |id| copy.job(id).await.expect("read").map(|job| job.state.name());
        assert_eq!(state("stays").await, Some("cancelled"));
        assert_eq!(state("again").await, Some("queued"));
        assert_eq!(state("goes").await, None);
        let left = ids.map(|id| path.join("jobs").join(id).exists());
        assert_eq!(left, [true, false, false]);
    }
}
