//! Where many machines share a store of files, each data directory is a copy of what it needs: what
//! is true stands in the rows that name the files, and in the store under their digests.
//!
//! A worker fetches a capture and what was made of its job before, and puts what its job makes into
//! the store, before it tells of it. Whoever answers a request fetches what has changed since.
//! Without such a store all this does nothing: the data directory is what is true.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, SystemTime};
use std::{fs, io};

use fled_blobs::{Blobs, Kept, pull, push};

use crate::app::App;
use crate::blob_cache::Copy;
use crate::error::{Result, ServerError};
use crate::failpoint::Failpoint;
use crate::janitor::remove;
use crate::store::{Claim, Lease, by_path};

/// Looks at a folder that changes, until one is of one moment.
const LOOKS: u32 = 5;

/// Between two looks.
const PAUSE: Duration = Duration::from_millis(20);

/// Path, and what changes when a file is written.
type Look = BTreeMap<String, (u64, i64, i64, u64)>;

/// Fetches what has changed of a job since it was fetched last; nothing of one that runs here.
///
/// # Errors
/// When the database, the store or the disk refuses.
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

/// Makes a job's folder what the store says, before a worker begins or goes on with it: what an
/// earlier attempt here has left, and never told of, goes.
///
/// # Errors
/// When the database, the store or the disk refuses.
pub async fn prepare_job(app: &App, claim: &Claim) -> Result<()> {
    let Some(blobs) = app.blob_cache.blobs() else {
        return Ok(());
    };
    let (job, capture) = (&claim.job.id, &claim.job.capture_id);
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
    used_now(&folder).map_err(ServerError::io(&folder))?;
    drop(copy);
    let copy = app.blob_cache.folder(job);
    let mut copy = copy.lock().await;
    if let Some(files) = app.store.job_files(job).await? {
        bring(blobs, &app.data.job(job), files, &mut copy).await?;
    }
    Ok(())
}

async fn bring(
    blobs: &Blobs,
    folder: &Path,
    (version, files): (i64, Vec<Kept>),
    copy: &mut Copy,
) -> Result<()> {
    pull(blobs, &files, folder, Some(&is_the_jobs), &mut copy.seen).await?;
    copy.version = Some(version);
    Ok(())
}

/// Notes on a folder when it was used last.
fn used_now(folder: &Path) -> io::Result<()> {
    match fs::File::open(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        folder => folder?.set_modified(SystemTime::now()),
    }
}

/// Puts what a job has made so far into the store and names it, under the job's lease. `at_end`
/// its process has ended: nothing changes any more.
///
/// # Errors
/// [`ServerError::LeaseLost`] when another worker has the job; else when the store refuses.
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
        // Of one moment: a file that was written after another must not be named without it.
        let before = look(&folder).await?;
        hold_still(&folder, &still, &before).await?;
        if look(&folder).await? != before {
            tokio::time::sleep(PAUSE).await;
            continue;
        }
        let pushed = push(blobs, &still, &is_the_jobs, &known, &mut copy.seen).await;
        remove(&still).await;
        let pushed = pushed?;
        if pushed.skipped > 0 {
            continue;
        }
        if pushed.kept.is_empty() && pushed.gone.is_empty() {
            return Ok(());
        }
        app.pass(Failpoint::Stored);
        app.store
            .keep_files(lease, &pushed.kept, &pushed.gone)
            .await?;
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

/// The same of a video that is made of a result, or is deleted, by whoever did so.
///
/// # Errors
/// When the database, the store or the disk refuses.
pub async fn publish_video(app: &App, job: &str, video: &str) -> Result<()> {
    let Some(blobs) = app.blob_cache.blobs() else {
        return Ok(());
    };
    let copy = app.blob_cache.folder(job);
    let mut copy = copy.lock().await;
    let Some((_, files)) = app.store.job_files(job).await? else {
        return Ok(());
    };
    let known = by_path(files);
    // Of others nothing is said: they may be somebody else's, who has them.
    let folder = format!("videos/{video}/");
    let is_its = |path: &str| path.starts_with(&folder);
    let pushed = push(blobs, &app.data.job(job), &is_its, &known, &mut copy.seen).await?;
    app.store.add_files(job, &pushed.kept, &pushed.gone).await?;
    Ok(())
}

/// Whether a file of a job's folder is for others: what renders and processes leave is not.
pub fn is_kept(path: &str) -> bool {
    path == "log.txt" || path.starts_with("output/") || is_video(path)
}

/// Whether a file is there because the job made it: no other may be there. Videos that are being
/// made here have no name yet.
fn is_the_jobs(path: &str) -> bool {
    is_kept(path) && !is_video(path)
}

fn is_video(path: &str) -> bool {
    path.starts_with("videos/")
}

/// Gives what is kept of a folder second names in another: a job that goes on replaces its files,
/// and leaves these as they were.
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
        // It grows all the time, and is nobody's ground.
        match fs::copy(from.join("log.txt"), to.join("log.txt")) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    });
    held.await
        .unwrap_or_else(|error| Err(io::Error::other(error)))
        .map_err(ServerError::io(folder))
}

/// What makes files of a folder others than they were; not of those that change all the time, and
/// whose state says nothing about others.
async fn look(folder: &Path) -> Result<Look> {
    let root = folder.to_owned();
    let look = tokio::task::spawn_blocking(move || {
        let mut look = Look::new();
        look_below(&root, &root, &mut look).map(|()| look)
    });
    look.await
        .unwrap_or_else(|error| Err(io::Error::other(error)))
        .map_err(ServerError::io(folder))
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
        } else if is_the_jobs(name) && name != "log.txt" && !name.ends_with("work/training.jpg") {
            let state = (about.size(), about.mtime(), about.mtime_nsec(), about.ino());
            look.insert(name.to_owned(), state);
        }
    }
    Ok(())
}
