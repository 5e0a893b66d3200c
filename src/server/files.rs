//! The files of a server: its data directory, its cache of a blob store, and uploads in progress.

pub mod blob_cache;
pub mod data;
pub mod incoming;
pub mod upload_locks;

use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;

/// Attempts to delete a folder that may still be written to: the processes of an earlier server end
/// shortly after it, as does a write for a client that disconnects.
const ATTEMPTS: u32 = 5;

/// Removes a file or a folder, if it exists.
///
/// # Errors
/// When the file system refuses.
pub fn delete(path: &Path) -> io::Result<()> {
    let mut attempts = 1..ATTEMPTS;
    loop {
        let deleted = fs::symlink_metadata(path).and_then(|about| match about.is_dir() {
            true => fs::remove_dir_all(path),
            false => fs::remove_file(path),
        });
        match deleted {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
            Err(error)
                if error.kind() == ErrorKind::DirectoryNotEmpty && attempts.next().is_some() => {}
            deleted => return deleted,
        }
    }
}

/// Removes the files of an item that is no longer in the database. An error is only logged: without
/// a row, the item counts as deleted.
pub async fn remove(path: &Path) {
    let from = path.to_owned();
    let removed = tokio::task::spawn_blocking(move || delete(&from)).await;
    if let Err(error) = removed.unwrap_or_else(|error| Err(io::Error::other(error))) {
        tracing::warn!(%error, path = %path.display(), "cannot remove");
    }
}
