//! Caching of a shared blob store: each data directory holds copies of the files it needs. The
//! source of truth is the rows that name the files, and the blob store, which holds them under
//! their digests.
//!
//! A worker fetches a capture and the earlier files of its job, and publishes new files before it
//! reports them. A replica fetches changed files before it answers a request. Without a blob store
//! all this does nothing: the data directory is the source of truth.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, SystemTime};
use std::{fs, io};

use fled_blobs::{Blobs, Kept, pull, push};

use crate::app::App;
use crate::error::{Result, ServerError};
use crate::failpoint::Failpoint;
use crate::files::blob_cache::Copy;
use crate::files::data::THUMBNAILS;
use crate::files::remove;
use crate::store::{Claim, Lease, by_path};

/// Scans of a changing folder until one is consistent.
const LOOKS: u32 = 5;

/// Pause between two scans.
const PAUSE: Duration = Duration::from_millis(20);

/// Files by path, with metadata that changes when a file is written.
type Look = BTreeMap<String, (u64, i64, i64, u64)>;

/// Fetches the files of a job that have changed since the last fetch; none for a job that runs
/// here.
///
/// # Errors
/// When the database, the blob store or the disk fails.
pub async fn fetch_job(app: &App, id: &str) -> Result<()> {
    let Some(blobs) = app.blob_cache.blobs() else {
        return Ok(());
    };
    if app.running.has(id) {
        return Ok(());
    }
    let copy = app.blob_cache.folder(id);
    let mut copy = copy.lock().await;
    let folder = app.data.job(id);
    used_now(&folder).map_err(ServerError::io(&folder))?;
    let version = app.store.files_version(id).await?;
    if version.is_none() || version == copy.version {
        return Ok(());
    }
    if let Some(files) = app.store.job_files(id).await? {
        bring(blobs, &folder, files, &mut copy).await?;
    }
    Ok(())
}

/// Makes a job's folder match the blob store before a worker starts or resumes the job: files left
/// here by an earlier attempt that did not report them are removed.
///
/// # Errors
/// When the database, the blob store or the disk fails.
pub async fn prepare_job(app: &App, claim: &Claim) -> Result<()> {
    let Some(blobs) = app.blob_cache.blobs() else {
        return Ok(());
    };
    let job = &claim.job.id;
    match &claim.job.video_of {
        Some(shown) => fetch_job(app, shown).await?,
        None => fetch_capture(app, blobs, &claim.job.capture_id).await?,
    }
    let copy = app.blob_cache.folder(job);
    let mut copy = copy.lock().await;
    if let Some(files) = app.store.job_files(job).await? {
        bring(blobs, &app.data.job(job), files, &mut copy).await?;
    }
    Ok(())
}

/// Fetches the thumbnails of a capture.
///
/// # Errors
/// When the database, the blob store or the disk fails.
pub async fn fetch_thumbnails(app: &App, capture: &str) -> Result<()> {
    let Some(blobs) = app.blob_cache.blobs() else {
        return Ok(());
    };
    let copy = app.blob_cache.folder(capture);
    let mut copy = copy.lock().await;
    let folder = app.data.capture(capture);
    if copy.version.is_none() {
        let mut files = app.store.capture_files(capture).await?;
        files.retain(|file| Path::new(&file.path).starts_with(THUMBNAILS));
        pull(blobs, &files, &folder, None, &mut copy.seen).await?;
    }
    used_now(&folder).map_err(ServerError::io(&folder))
}

/// Fetches a whole capture, including its photographs.
///
/// # Errors
/// When the database, the blob store or the disk fails.
pub async fn fetch_photographs(app: &App, capture: &str) -> Result<()> {
    match app.blob_cache.blobs() {
        Some(blobs) => fetch_capture(app, blobs, capture).await,
        None => Ok(()),
    }
}

async fn fetch_capture(app: &App, blobs: &Blobs, capture: &str) -> Result<()> {
    let copy = app.blob_cache.folder(capture);
    let mut copy = copy.lock().await;
    let folder = app.data.capture(capture);
    // A capture never changes.
    if copy.version.is_none() {
        let files = app.store.capture_files(capture).await?;
        pull(blobs, &files, &folder, None, &mut copy.seen).await?;
        if !files.is_empty() {
            copy.version = Some(0);
        }
    }
    used_now(&folder).map_err(ServerError::io(&folder))
}

async fn bring(
    blobs: &Blobs,
    folder: &Path,
    (version, files): (i64, Vec<Kept>),
    copy: &mut Copy,
) -> Result<()> {
    pull(blobs, &files, folder, Some(&is_kept), &mut copy.seen).await?;
    copy.version = Some(version);
    Ok(())
}

/// Updates a folder's modification time to record its use.
fn used_now(folder: &Path) -> io::Result<()> {
    match fs::File::open(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        folder => folder?.set_modified(SystemTime::now()),
    }
}

/// Publishes the files of a job to the blob store and names them, under the job's lease. `at_end`
/// means that its process has ended and nothing changes any more.
///
/// # Errors
/// [`ServerError::LeaseLost`] if another worker has the job; otherwise when the blob store fails.
pub async fn publish(app: &App, lease: &Lease, at_end: bool) -> Result<()> {
    let Some(blobs) = app.blob_cache.blobs() else {
        return Ok(());
    };
    let copy = app.blob_cache.folder(&lease.job);
    let mut copy = copy.lock().await;
    let Some((_, files)) = app.store.job_files(&lease.job).await? else {
        return Err(ServerError::LeaseLost(lease.job.clone()));
    };
    let known = by_path(files);
    let folder = app.data.job(&lease.job);
    let still = folder.join("still");
    for _ in 0..LOOKS {
        // A consistent snapshot: a file written after another must not be named without it.
        let before = look(&folder).await?;
        hold_still(&folder, &still, &before).await?;
        if look(&folder).await? != before {
            tokio::time::sleep(PAUSE).await;
            continue;
        }
        let pushed = push(blobs, &still, &is_kept, &known, &mut copy.seen).await;
        remove(&still).await;
        let pushed = pushed?;
        if pushed.skipped > 0 {
            continue;
        }
        if pushed.kept.is_empty() && pushed.gone.is_empty() {
            return Ok(());
        }
        app.pass(Failpoint::Stored);
        app.store.keep_files(lease, &pushed.kept, &pushed.gone).await?;
        app.pass(Failpoint::Named);
        return Ok(());
    }
    if at_end {
        return Err(ServerError::Io {
            path: folder,
            source: io::Error::other("the files of a job change although it has ended"),
        });
    }
    tracing::debug!(job = lease.job, "its files change too fast: later");
    Ok(())
}

/// Whether a file of a job's folder is shared: files left by renders and processes are not, nor is
/// the prepared capture, which another machine prepares again in seconds.
pub fn is_kept(path: &str) -> bool {
    // Builds before CODE_VERSION 10 kept it in `capture`.
    let prepared = ["output/work/prepared/", "output/work/capture/"];
    let is_prepared = prepared.iter().any(|folder| path.starts_with(folder));
    path == "log.txt" || path.starts_with("output/") && !is_prepared
}

/// Hard-links the shared files of a folder into another: a running job replaces its files, which
/// leaves the links unchanged.
async fn hold_still(folder: &Path, still: &Path, look: &Look) -> Result<()> {
    let names: Vec<String> = look.keys().cloned().collect();
    let (from, to) = (folder.to_owned(), still.to_owned());
    let held = tokio::task::spawn_blocking(move || {
        if to.exists() {
            fs::remove_dir_all(&to)?;
        }
        fs::create_dir_all(&to)?;
        for name in names {
            let second = to.join(&name);
            fs::create_dir_all(second.parent().unwrap_or(&to))?;
            match fs::hard_link(from.join(&name), second) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                linked => linked?,
            }
        }
        // The log grows all the time, and no other file depends on it.
        match fs::copy(from.join("log.txt"), to.join("log.txt")) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    });
    held.await.unwrap_or_else(|error| Err(io::Error::other(error))).map_err(ServerError::io(folder))
}

/// Scans the metadata of a folder's files, except those that change all the time and on which no
/// other file depends.
async fn look(folder: &Path) -> Result<Look> {
    let root = folder.to_owned();
    let look = tokio::task::spawn_blocking(move || {
        let mut look = Look::new();
        look_below(&root, &root, &mut look).map(|()| look)
    });
    look.await.unwrap_or_else(|error| Err(io::Error::other(error))).map_err(ServerError::io(folder))
}

fn look_below(root: &Path, dir: &Path, look: &mut Look) -> io::Result<()> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        let path = entry.path();
        let about = match entry.metadata() {
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            about => about?,
        };
        let Some(name) = path.strip_prefix(root).ok().and_then(Path::to_str) else {
            continue;
        };
        if about.is_dir() {
            look_below(root, &path, look)?;
        } else if is_kept(name) && name != "log.txt" && !name.ends_with("work/training.jpg") {
            let state = (about.size(), about.mtime(), about.mtime_nsec(), about.ino());
            look.insert(name.to_owned(), state);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use fled_core::run_folder::RunFolder;

    use super::is_kept;

    #[test]
    fn a_prepared_capture_is_not_shared_and_a_result_is() {
        let run = RunFolder::new("output");
        let prepared = run.work().prepared().join("a.half");
        assert!(!is_kept(prepared.to_str().expect("UTF-8")));
        for path in [run.scene(), run.work().checkpoint(), run.work().found_poses()] {
            assert!(is_kept(path.to_str().expect("UTF-8")), "{path:?}");
        }
    }
}
