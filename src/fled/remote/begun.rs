//! The uploads of a submission, kept until its job is accepted: a second command continues one that
//! was killed.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::tools::cache_home;

/// The service deletes unused uploads a day after their last byte.
const KEPT: Duration = Duration::from_secs(2 * 24 * 3600);

/// Ids of uploads by the places of their files in the capture: names may be equal.
#[derive(Debug, Default)]
pub struct Begun {
    ids: BTreeMap<usize, String>,
    kept: Option<Kept>,
}

/// The file of a submission: a line for each upload, the last of which counts. It is locked, so
/// that two commands never send to one upload.
#[derive(Debug)]
struct Kept {
    path: PathBuf,
    file: File,
}

impl Begun {
    /// Those of an earlier command that sent the same capture, of this digest, to the same server.
    /// They are not kept if this user has no home or another command is sending them now.
    pub fn open(server: &str, digest: &blake3::Hash) -> Self {
        let folder = cache_home().map(|cache| cache.join("submissions"));
        folder.map_or_else(Self::default, |folder| Self::open_in(&folder, server, digest))
    }

    fn open_in(folder: &Path, server: &str, digest: &blake3::Hash) -> Self {
        remove_old(folder);
        let mut hasher = blake3::Hasher::new();
        hasher.update(digest.as_bytes()).update(server.as_bytes());
        let path = folder.join(format!("{}.uploads", hasher.finalize().to_hex()));
        match lock(&path) {
            Ok(Some(mut file)) => match read(&mut file) {
                Ok(ids) => return Self { ids, kept: Some(Kept { path, file }) },
                Err(error) => not_kept(&path, &error),
            },
            Ok(None) => {
                eprintln!("another command is sending this capture: this one sends all of it, too");
            }
            Err(error) => not_kept(&path, &error),
        }
        Self::default()
    }

    /// The upload of the file at a place.
    pub fn of(&self, at: usize) -> Option<&str> {
        self.ids.get(&at).map(String::as_str)
    }

    /// The ids of all uploads.
    pub fn ids(&self) -> Vec<String> {
        self.ids.values().cloned().collect()
    }

    /// Keeps the upload that was begun for the file at a place; says so if that fails.
    pub fn set(&mut self, at: usize, id: String) {
        if let Some(Kept { path, file }) = &mut self.kept {
            // In one piece, so that the end of the process leaves at most one incomplete line.
            let line = format!("{}\n", serde_json::json!([at, id]));
            if let Err(error) = file.write_all(line.as_bytes()) {
                not_kept(path, &error);
                self.kept = None;
            }
        }
        self.ids.insert(at, id);
    }

    /// Forgets them, because a job has used them up, or they were deleted.
    pub fn forget(&mut self) {
        self.ids.clear();
        if let Some(kept) = self.kept.take() {
            // Emptied, too, for a command that has opened it. Uploads that are gone begin anew.
            let _ = kept.file.set_len(0);
            let _ = std::fs::remove_file(&kept.path);
        }
    }
}

impl Drop for Kept {
    /// Closing the file would not do: a child process that another thread is starting holds a copy
    /// of it, and with it the lock, until its program runs.
    fn drop(&mut self) {
        let _ = self.file.unlock();
    }
}

/// Opens and locks the file of a submission; `None` if another command holds it.
fn lock(path: &Path) -> io::Result<Option<File>> {
    path.parent().map_or(Ok(()), std::fs::create_dir_all)?;
    let file = OpenOptions::new().read(true).append(true).create(true).open(path)?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Reads a file's uploads and removes an incomplete last line.
fn read(file: &mut File) -> io::Result<BTreeMap<usize, String>> {
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
    file.set_len(whole as u64)?;
    let lines = bytes[..whole].split(|byte| *byte == b'\n');
    Ok(lines.filter_map(|line| serde_json::from_slice(line).ok()).collect())
}

fn not_kept(path: &Path, error: &io::Error) {
    eprintln!("{}: {error}; if it is killed, this command begins anew", path.display());
}

/// Removes the files of submissions whose uploads have expired.
fn remove_old(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let modified = entry.metadata().and_then(|about| about.modified());
        let age = modified.ok().and_then(|time| time.elapsed().ok());
        if age.is_some_and(|age| age > KEPT) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uploads_are_found_again_by_server_and_capture_until_they_are_forgotten() {
        let home = tempfile::tempdir().expect("temporary folder");
        let folder = home.path().join("submissions");
        let digest = blake3::hash(b"a capture");
        let open = |server: &str, of: &blake3::Hash| Begun::open_in(&folder, server, of);
        let mut begun = open("http://a", &digest);
        assert_eq!(begun.of(0), None);
        for (at, id) in [(0, "expired"), (7, "two"), (0, "one")] {
            begun.set(at, id.to_owned());
        }
        drop(begun);
        assert_eq!(open("http://a", &digest).ids(), ["one", "two"]);
        assert_eq!(open("http://b", &digest).of(0), None);
        assert_eq!(open("http://a", &blake3::hash(b"another")).of(0), None);
        let mut begun = open("http://a", &digest);
        assert_eq!((begun.of(0), begun.of(7)), (Some("one"), Some("two")));
        begun.forget();
        assert_eq!(open("http://a", &digest).of(0), None);
    }

    #[test]
    fn a_line_that_was_cut_short_loses_no_other() {
        let home = tempfile::tempdir().expect("temporary folder");
        let digest = blake3::hash(b"a capture");
        let open = || Begun::open_in(home.path(), "http://a", &digest);
        let mut begun = open();
        begun.set(0, "one".to_owned());
        begun.set(1, "two".to_owned());
        let kept = begun.kept.take().expect("kept");
        kept.file.set_len(kept.file.metadata().expect("there").len() - 3).expect("cut");
        drop(kept);
        let mut begun = open();
        assert_eq!(begun.ids(), ["one"]);
        begun.set(1, "three".to_owned());
        drop(begun);
        assert_eq!(open().ids(), ["one", "three"]);
    }

    #[test]
    fn two_commands_at_once_share_no_upload() {
        let home = tempfile::tempdir().expect("temporary folder");
        let digest = blake3::hash(b"a capture");
        let open = || Begun::open_in(home.path(), "http://a", &digest);
        let mut first = open();
        first.set(0, "one".to_owned());
        let mut second = open();
        assert_eq!(second.of(0), None);
        second.set(0, "two".to_owned());
        second.forget();
        drop(first);
        assert_eq!(open().ids(), ["one"]);
    }
}
