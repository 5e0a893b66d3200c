//! Frees what nobody names any more.
//!
//! Files and rows cannot change together: a server that dies between the two leaves files without
//! a row, never a row without files. They are looked for at the start and every hour.

use std::collections::HashSet;
use std::fs::{self, DirEntry, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::app::App;
use crate::error::{Result, ServerError};

/// Between two sweeps.
const PERIOD: Duration = Duration::from_secs(3600);
/// Poses that were found longer ago are found again, when they are wanted.
const POSES_KEPT: Duration = Duration::from_secs(30 * 24 * 3600);

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
    }
}

/// Removes the files of captures and jobs that have no row, of uploads and renders that came to
/// nothing, and old poses. Only what has not changed for `age`: what is being made has no row yet.
/// Returns how many things were removed.
///
/// # Errors
/// When the database or the data directory cannot be read.
pub async fn sweep(app: &Arc<App>, age: Duration) -> Result<usize> {
    // What is stored after this is younger than `age`; at the start nothing is stored meanwhile.
    let captures = app.store.ids("captures").await?;
    let jobs = app.store.ids("jobs").await?;
    let shared = app.clone();
    let swept = tokio::task::spawn_blocking(move || sweep_files(&shared, &captures, &jobs, age));
    swept.await.unwrap_or_else(|error| {
        Err(ServerError::Io {
            path: app.data.jobs(),
            source: io::Error::other(error),
        })
    })
}

fn sweep_files(
    app: &App,
    captures: &HashSet<String>,
    jobs: &HashSet<String>,
    age: Duration,
) -> Result<usize> {
    let data = &app.data;
    let named = |ids: &HashSet<String>, entry: &DirEntry| {
        entry
            .file_name()
            .to_str()
            .is_some_and(|name| ids.contains(name))
    };
    let mut swept = remove_from(&data.captures(), age, |entry| !named(captures, entry))?;
    swept += remove_from(&data.jobs(), age, |entry| !named(jobs, entry))?;
    swept += remove_from(&data.incoming(), age, |entry| {
        !app.uploads.uses(&entry.path())
    })?;
    swept += remove_from(&data.cache(), age.max(POSES_KEPT), |_| true)?;
    for id in jobs {
        swept += remove_from(&data.renders(id), age, |entry| {
            entry
                .path()
                .extension()
                .is_some_and(|extension| extension == "tmp")
        })?;
    }
    Ok(swept)
}

/// Removes what lies in `dir`, has not changed for `age` and is not wanted.
fn remove_from(dir: &Path, age: Duration, is_left: impl Fn(&DirEntry) -> bool) -> Result<usize> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(0),
        entries => entries.map_err(ServerError::io(dir))?,
    };
    let mut swept = 0;
    for entry in entries {
        let entry = entry.map_err(ServerError::io(dir))?;
        let Ok(metadata) = entry.metadata() else {
            // It went meanwhile.
            continue;
        };
        if changed_within(&metadata, age) || !is_left(&entry) {
            continue;
        }
        let path = entry.path();
        let removed = if metadata.is_dir() {
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
        let missing = dir.path().join("missing");
        assert_eq!(remove_from(&missing, none, is_left).expect("nothing"), 0);
    }
}
