//! The rules for files in a data directory.

use std::collections::HashSet;
use std::fs::{self, DirEntry, Metadata};
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::{Gone, Janitor, Name, Rule};
use crate::error::{Result, ServerError};
use crate::files::data::bytes_below;
use crate::files::delete;

impl Janitor<'_> {
    /// Returns the paths that a file rule removes.
    pub(super) async fn find(&self, rule: Name) -> Result<Vec<PathBuf>> {
        let (data, mut found) = (self.data, Vec::new());
        let mut add = |dir: &Path, age: Duration, goes: &dyn Fn(&DirEntry) -> bool| {
            let old = find(dir, age.max(self.made), goes);
            old.map(|old| found.extend(old)).map_err(ServerError::io(dir))
        };
        // Entries that get a row after this are younger than `made`, or no entry can get one
        // meanwhile.
        let ids = async |kind| self.store.ids(kind).await;
        match rule {
            Name::SpareUploads => {
                // An empty upload holds no data, and the bytes of a hard-linked one belong to a
                // capture.
                let uploads = ids("uploads").await?;
                let is_spare = |about: Metadata| about.len() == 0 || about.nlink() > 1;
                add(&data.uploads(), Duration::ZERO, &|entry| {
                    !is_named(&uploads, entry) && entry.metadata().is_ok_and(is_spare)
                })?;
            }
            Name::OldOrphans => {
                for dir in [data.captures(), data.jobs(), data.uploads()] {
                    add(&data.unnamed(&dir), self.orphans, &|_| true)?;
                }
            }
            Name::Orphans => {
                for (kind, dir) in [
                    ("captures", data.captures()),
                    ("jobs", data.jobs()),
                    ("uploads", data.uploads()),
                ] {
                    let ids = ids(kind).await?;
                    add(&dir, Duration::ZERO, &|entry| !is_named(&ids, entry))?;
                }
            }
            Name::Unfinished => {
                // Only this directory's server knows which uploads are in progress.
                if data.is_ours() {
                    let uses = |path: &Path| self.app.is_some_and(|app| app.uploads.uses(path));
                    add(&data.incoming(), Duration::ZERO, &|entry| !uses(&entry.path()))?;
                }
                let is_half = |path: PathBuf| path.extension().is_some_and(|end| end == "tmp");
                for id in ids("jobs").await? {
                    add(&data.renders(&id), Duration::ZERO, &|entry| is_half(entry.path()))?;
                }
            }
            Name::Caches => {
                let is_file = |entry: &DirEntry| entry.file_type().is_ok_and(|kind| kind.is_file());
                add(&data.cache(), self.caches, &is_file)?;
                // Each file of poses is used on its own, and a run touches the one that it uses.
                add(&data.cached_poses(), self.caches, &|_| true)?;
                // A server keeps its renders.
                if self.app.is_none() {
                    for id in ids("jobs").await? {
                        add(&data.renders(&id), self.caches, &|_| true)?;
                    }
                }
            }
            _ => {}
        }
        Ok(found)
    }

    /// Removes a path or moves it aside, and reports it. Returns whether it has gone.
    pub(super) fn remove(&mut self, rule: &Rule, path: PathBuf) -> bool {
        if self.reported.iter().any(|gone| path.starts_with(gone)) {
            return false;
        }
        let is_orphan = matches!(rule.name, Name::Orphans);
        let bytes = if is_orphan { Ok(0) } else { bytes_of(&path) };
        let gone = bytes.and_then(|bytes| match path.parent() {
            _ if self.dry_run => Ok(bytes),
            Some(dir) if is_orphan => move_aside(&path, &self.data.unnamed(dir)).map(|()| bytes),
            _ => delete(&path).map(|()| {
                tracing::info!(path = %path.display(), bytes, why = rule.what, "removed");
                bytes
            }),
        });
        match gone.map_err(ServerError::io(&path)) {
            Err(error) => {
                self.fail(rule, error);
                false
            }
            Ok(bytes) => {
                let below = path.strip_prefix(self.data.root()).unwrap_or(&path);
                (self.report)(&Gone { path: below.to_owned(), bytes, why: rule.what });
                self.reported.push(path);
                true
            }
        }
    }
}

fn is_named(ids: &HashSet<String>, entry: &DirEntry) -> bool {
    let name = entry.file_name();
    name.to_str().is_some_and(|name| ids.contains(name))
}

/// Returns the entries of a folder that match `goes` and have not changed for `age`; none if the
/// folder does not exist.
fn find(dir: &Path, age: Duration, goes: &dyn Fn(&DirEntry) -> bool) -> io::Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let entry = entry?;
        // An entry without metadata was removed meanwhile.
        let is_old = |about: Metadata| !changed_within(&about, age);
        if entry.metadata().is_ok_and(is_old) && goes(&entry) {
            found.push(entry.path());
        }
    }
    Ok(found)
}

/// Returns whether a file was written or moved here within `age`.
fn changed_within(metadata: &Metadata, age: Duration) -> bool {
    let changed = UNIX_EPOCH + Duration::from_secs(u64::try_from(metadata.ctime()).unwrap_or(0));
    // If the clock was set back, files look young and stay.
    let old = SystemTime::now().duration_since(changed).unwrap_or_default();
    old < age
}

/// Moves a path aside without overwriting anything.
fn move_aside(path: &Path, aside: &Path) -> io::Result<()> {
    fs::create_dir_all(aside)?;
    let name = path.file_name().unwrap_or_default();
    let mut to = aside.join(name);
    for copy in 2.. {
        if !to.exists() {
            break;
        }
        to = aside.join(name).with_added_extension(copy.to_string());
    }
    fs::rename(path, &to)?;
    tracing::warn!(
        from = %path.display(),
        to = %to.display(),
        "moved aside for 30 days: the database does not know it. If the database is an older copy, \
         stop the server, restore the right one and move this back; photographs can also be \
         uploaded again from here"
    );
    Ok(())
}

/// Bytes freed by removing a path: none if the file has another hard link or has gone.
fn bytes_of(path: &Path) -> io::Result<u64> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(0),
        Ok(about) if about.is_dir() => bytes_below(path),
        Ok(about) => Ok(if about.nlink() > 1 { 0 } else { about.len() }),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_old_unneeded_files_are_removed() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let (place, aside) = (dir.path().join("place"), dir.path().join("aside"));
        let find = |hours: u64| {
            let age = Duration::from_secs(hours * 3600);
            find(&place, age, &|entry| entry.file_name() != "named").expect("read")
        };
        assert!(find(0).is_empty(), "there is no such folder");
        fs::create_dir_all(place.join("named")).expect("made");
        for _ in 0..2 {
            fs::create_dir(place.join("lost")).expect("made");
            assert!(find(1).is_empty());
            let found = find(0);
            assert_eq!(found, [place.join("lost")]);
            move_aside(&found[0], &aside).expect("moved");
        }
        assert!(aside.join("lost").exists() && aside.join("lost.2").exists());
        for path in [&aside, &aside, &place.join("none")] {
            delete(path).expect("deleted");
            assert!(!path.exists());
        }
    }
}
