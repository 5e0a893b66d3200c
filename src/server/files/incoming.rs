//! Folders of uploads in progress.

use std::collections::HashSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use uuid::Uuid;

use crate::files::delete;

/// The uploads in progress.
#[derive(Clone, Debug, Default)]
pub struct Uploads(Arc<Mutex<HashSet<PathBuf>>>);

/// The folder of an upload in progress. Unless it was moved away, it is removed when its last user
/// drops it: a client that disconnects does not remove files that are still being validated.
#[derive(Debug)]
pub struct Incoming {
    path: PathBuf,
    uploads: Uploads,
}

impl Uploads {
    /// Creates a new folder below `parent`.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn begin(&self, parent: &Path) -> io::Result<Arc<Incoming>> {
        let path = parent.join(Uuid::now_v7().to_string());
        self.lock().insert(path.clone());
        let incoming = Arc::new(Incoming { path, uploads: self.clone() });
        fs::create_dir(&incoming.path)?;
        Ok(incoming)
    }

    /// Returns whether an upload in progress uses this folder.
    pub fn uses(&self, path: &Path) -> bool {
        self.lock().contains(path)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, HashSet<PathBuf>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Incoming {
    /// The path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Incoming {
    fn drop(&mut self) {
        // After the move into place it no longer exists.
        if let Err(error) = delete(&self.path) {
            tracing::debug!(%error, "an upload's folder waits for the janitor");
        }
        self.uploads.lock().remove(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_removed_with_its_last_user() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let uploads = Uploads::default();
        let upload = uploads.begin(dir.path()).expect("a folder");
        let path = upload.path().to_owned();
        let looks = upload.clone();
        drop(upload);
        // The client has disconnected; its photographs are still being validated.
        fs::create_dir_all(path.join(".examined/unpacked")).expect("unpacked");
        assert!(path.join(".examined").exists() && uploads.uses(&path));
        drop(looks);
        assert!(!path.exists() && !uploads.uses(&path));
    }

    #[test]
    fn a_folder_that_was_moved_into_place_stays_there() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let upload = Uploads::default().begin(dir.path()).expect("a folder");
        let kept = dir.path().join("kept");
        fs::rename(upload.path(), &kept).expect("moved");
        drop(upload);
        assert!(kept.exists());
    }
}
