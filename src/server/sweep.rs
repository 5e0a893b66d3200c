//! Frees what nobody names any more.
//!
//! Files and rows cannot change together: a server that dies between the two leaves files without
//! a row, never a row without files. They are looked for at the start and every hour.
//!
//! A database that was restored from an older copy names less than there is, too. So captures, jobs
//! and uploads without a row are kept aside for a while before they go.

use std::collections::HashSet;
use std::fs::{self, DirEntry, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::app::App;
use crate::error::{Result, ServerError};
use crate::expiry::expire;
use crate::store::now_ms;
use crate::uploads::{expire_uploads, forget_lost};

/// Between two sweeps.
const PERIOD: Duration = Duration::from_secs(3600);
/// Poses that were found longer ago are found again, when they are wanted.
const POSES_KEPT: Duration = Duration::from_secs(30 * 24 * 3600);

/// What webhooks were told is known for so long, milliseconds.
const DELIVERIES_KEPT_MS: i64 = 30 * 24 * 3600 * 1000;

/// Captures, jobs and uploads without a row are kept aside for so long.
const UNNAMED_KEPT: Duration = Duration::from_secs(30 * 24 * 3600);

/// Sweeps now and then until the server stops.
pub async fn keep_sweeping(app: Arc<App>) {
    loop {
        tokio::select! {
            () = tokio::time::sleep(PERIOD) => {}
            () = app.shutdown.cancelled() => return,
        }
        if let Err(error) = sweep(&app, PERIOD).await {
            tracing::warn!(%error, "cannot look for files that nobody names");
        }
        let told_until = now_ms() - DELIVERIES_KEPT_MS;
        if let Err(error) = app.store.forget_deliveries(told_until).await {
            tracing::warn!(%error, "cannot forget what webhooks were told");
        }
        if let Err(error) = expire(&app).await {
            tracing::warn!(%error, "cannot delete what is kept no longer");
        }
    }
}

/// Moves captures, jobs and uploads that have no row aside, and removes uploads and renders that
/// came to nothing, old poses, and what has been aside for long. Only what has not changed for
/// `age`: what is being made has no row yet. Returns how many things were moved and removed.
///
/// # Errors
/// When the database or the data directory cannot be read.
pub async fn sweep(app: &Arc<App>, age: Duration) -> Result<usize> {
    // What is stored after this is younger than `age`; at the start nothing is stored meanwhile.
    let captures = app.store.ids("captures").await?;
    let jobs = app.store.ids("jobs").await?;
    let named = Named {
        captures,
        jobs,
        uploads: app.store.ids("uploads").await?,
    };
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

/// The ids of what has a row.
struct Named {
    captures: HashSet<String>,
    jobs: HashSet<String>,
    uploads: HashSet<String>,
}

fn sweep_files(app: &App, rows: &Named, age: Duration) -> Result<usize> {
    let data = &app.data;
    let named = |ids: &HashSet<String>, entry: &DirEntry| {
        entry
            .file_name()
            .to_str()
            .is_some_and(|name| ids.contains(name))
    };
    let mut swept = 0;
    // Of an upload that is empty nothing is lost, nor of one whose bytes a capture has: by a second
    // name of the same file.
    swept += remove_from(&data.uploads(), age, |entry| {
        let is_spare = |about: Metadata| about.len() == 0 || about.nlink() > 1;
        !named(&rows.uploads, entry) && entry.metadata().is_ok_and(is_spare)
    })?;
    for (from, ids) in [
        (data.captures(), &rows.captures),
        (data.jobs(), &rows.jobs),
        (data.uploads(), &rows.uploads),
    ] {
        let aside = data.unnamed(&from);
        swept += remove_from(&aside, age.max(UNNAMED_KEPT), |_| true)?;
        swept += set_aside(&from, &aside, age, |entry| !named(ids, entry))?;
    }
    swept += remove_from(&data.incoming(), age, |entry| {
        !app.uploads.uses(&entry.path())
    })?;
    swept += remove_from(&data.cache(), age.max(POSES_KEPT), |_| true)?;
    for id in &rows.jobs {
        swept += remove_from(&data.renders(id), age, |entry| {
            entry
                .path()
                .extension()
                .is_some_and(|extension| extension == "tmp")
        })?;
    }
    Ok(swept)
}

/// What lies in `dir`, has not changed for `age` and is not wanted, and whether it is a folder.
fn left_in(
    dir: &Path,
    age: Duration,
    is_left: impl Fn(&DirEntry) -> bool,
) -> Result<Vec<(PathBuf, bool)>> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(ServerError::io(dir))?,
    };
    let mut left = Vec::new();
    for entry in entries {
        let entry = entry.map_err(ServerError::io(dir))?;
        let Ok(metadata) = entry.metadata() else {
            // It went meanwhile.
            continue;
        };
        if !changed_within(&metadata, age) && is_left(&entry) {
            left.push((entry.path(), metadata.is_dir()));
        }
    }
    Ok(left)
}

/// Moves what is left in `dir` to `aside`, where nothing is lost that is there already.
fn set_aside(
    dir: &Path,
    aside: &Path,
    age: Duration,
    is_left: impl Fn(&DirEntry) -> bool,
) -> Result<usize> {
    let mut swept = 0;
    for (path, _) in left_in(dir, age, is_left)? {
        fs::create_dir_all(aside).map_err(ServerError::io(aside))?;
        let name = path.file_name().unwrap_or_default();
        let mut to = aside.join(name);
        for copy in 2.. {
            if !to.exists() {
                break;
            }
            to = aside.join(name).with_added_extension(copy.to_string());
        }
        match fs::rename(&path, &to) {
            Ok(()) => {
                tracing::warn!(
                    from = %path.display(),
                    to = %to.display(),
                    "moved aside for 30 days: the database does not name it. If the database is an \
                     older copy, stop the server, put the right one in place and move this back; \
                     photographs can also be uploaded again from here"
                );
                swept += 1;
            }
            Err(error) => tracing::warn!(%error, path = %path.display(), "cannot be moved aside"),
        }
    }
    Ok(swept)
}

/// Removes what is left in `dir`.
fn remove_from(dir: &Path, age: Duration, is_left: impl Fn(&DirEntry) -> bool) -> Result<usize> {
    let mut swept = 0;
    for (path, is_dir) in left_in(dir, age, is_left)? {
        let removed = if is_dir {
            fs::remove_dir_all(&path)
        } else {
            fs::remove_file(&path)
        };
        match removed {
            Ok(()) => {
                tracing::info!(path = %path.display(), "removed: nobody names it");
                swept += 1;
            }
            Err(error) => tracing::warn!(%error, path = %path.display(), "cannot be removed"),
        }
    }
    Ok(swept)
}

/// Whether something was written or moved here within `age`.
fn changed_within(metadata: &Metadata, age: Duration) -> bool {
    let changed = UNIX_EPOCH + Duration::from_secs(u64::try_from(metadata.ctime()).unwrap_or(0));
    // A clock that was set back makes things young, and they stay.
    let old = SystemTime::now()
        .duration_since(changed)
        .unwrap_or_default();
    old < age
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_has_not_changed_for_long_and_is_not_wanted_goes() {
        let dir = tempfile::tempdir().expect("temporary directory");
        for name in ["left", "named"] {
            fs::create_dir(dir.path().join(name)).expect("made");
        }
        fs::write(dir.path().join("file.json"), "{}").expect("written");
        let is_left = |entry: &DirEntry| entry.file_name() != "named";
        let hour = Duration::from_secs(3600);
        assert_eq!(remove_from(dir.path(), hour, is_left).expect("swept"), 0);
        let none = Duration::ZERO;
        assert_eq!(remove_from(dir.path(), none, is_left).expect("swept"), 2);
        assert!(dir.path().join("named").exists());
        let aside = dir.path().join("aside");
        for _ in 0..2 {
            fs::create_dir(dir.path().join("lost")).expect("made");
            let is_lost = |entry: &DirEntry| entry.file_name() == "lost";
            assert_eq!(
                set_aside(dir.path(), &aside, hour, is_lost).expect("swept"),
                0
            );
            assert_eq!(
                set_aside(dir.path(), &aside, none, is_lost).expect("swept"),
                1
            );
        }
        assert!(aside.join("lost").exists() && aside.join("lost.2").exists());
        let missing = dir.path().join("missing");
        assert_eq!(remove_from(&missing, none, is_left).expect("nothing"), 0);
    }
}
