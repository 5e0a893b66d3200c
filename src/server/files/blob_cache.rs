//! This machine's cache of a shared blob store: the cached folders, and the last known state of
//! their files.

use std::collections::HashMap;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use fled_blobs::{Blobs, Kept, Seen, push};

use crate::error::{Result, ServerError};

/// This machine's cache of the blob store.
#[derive(Debug, Default)]
pub struct BlobCache {
    blobs: Option<Blobs>,
    folders: Mutex<HashMap<String, Arc<tokio::sync::Mutex<Copy>>>>,
}

/// The cached state of one folder.
#[derive(Debug, Default)]
pub struct Copy {
    /// The version of its files.
    pub version: Option<i64>,
    /// The last known state of its files.
    pub seen: Seen,
}

impl BlobCache {
    /// A cache of `blobs`, or of no store.
    pub fn new(blobs: Option<Blobs>) -> Self {
        Self { blobs, ..Self::default() }
    }

    /// The blob store, if there is one.
    pub fn blobs(&self) -> Option<&Blobs> {
        self.blobs.as_ref()
    }

    /// The state of a job's or capture's folder, by id; the mutex admits one user at a time.
    pub fn folder(&self, name: &str) -> Arc<tokio::sync::Mutex<Copy>> {
        let mut folders = self.folders.lock().unwrap_or_else(PoisonError::into_inner);
        folders.entry(name.to_owned()).or_default().clone()
    }

    /// Drops the state of a removed folder.
    pub fn forget(&self, name: &str) {
        let mut folders = self.folders.lock().unwrap_or_else(PoisonError::into_inner);
        folders.remove(name);
    }

    /// Puts the files of a new capture, or of a job that ended elsewhere, into the blob store and
    /// returns the files that its row must name.
    ///
    /// # Errors
    /// When the blob store or the disk fails.
    pub async fn keep_new(&self, folder: &Path) -> Result<Vec<Kept>> {
        let Some(blobs) = &self.blobs else {
            return Ok(Vec::new());
        };
        let none = HashMap::new();
        let pushed = push(blobs, folder, &|_| true, &none, &mut Seen::default()).await?;
        if pushed.skipped > 0 {
            return Err(ServerError::Io {
                path: folder.to_owned(),
                source: io::Error::other("a new file changed while it was stored"),
            });
        }
        Ok(pushed.kept)
    }
}
