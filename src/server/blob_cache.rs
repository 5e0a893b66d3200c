//! This machine's cache of what lies in a shared store of files: which copies there are, and what
//! is known of them.

use std::collections::HashMap;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use fled_blobs::{Blobs, Kept, Seen, push};

use crate::error::{Result, ServerError};

/// This machine's copies of what lies in the store of files.
#[derive(Debug, Default)]
pub struct BlobCache {
    blobs: Option<Blobs>,
    folders: Mutex<HashMap<String, Arc<tokio::sync::Mutex<Copy>>>>,
}

/// One folder as far as it is known.
#[derive(Debug, Default)]
pub struct Copy {
    /// Of the files that it has.
    pub version: Option<i64>,
    /// What is known of its files.
    pub seen: Seen,
}

impl BlobCache {
    /// Copies of what lies in `blobs`, or no copies.
    pub fn new(blobs: Option<Blobs>) -> Self {
        Self {
            blobs,
            ..Self::default()
        }
    }

    /// The store of files, where there is one.
    pub fn blobs(&self) -> Option<&Blobs> {
        self.blobs.as_ref()
    }

    /// What is known of a folder, by the id of its job or capture; for one at a time.
    pub fn folder(&self, name: &str) -> Arc<tokio::sync::Mutex<Copy>> {
        let mut folders = self.folders.lock().unwrap_or_else(PoisonError::into_inner);
        folders.entry(name.to_owned()).or_default().clone()
    }

    /// Forgets what is known of a folder that is removed.
    pub fn forget(&self, name: &str) {
        let mut folders = self.folders.lock().unwrap_or_else(PoisonError::into_inner);
        folders.remove(name);
    }

    /// Puts the files of a new capture into the store: what its row is to name.
    ///
    /// # Errors
    /// When the store or the disk refuses.
    pub async fn keep_capture(&self, folder: &Path) -> Result<Vec<Kept>> {
        let Some(blobs) = &self.blobs else {
            return Ok(Vec::new());
        };
        let none = HashMap::new();
        let pushed = push(blobs, folder, &|_| true, &none, &mut Seen::default()).await?;
        if pushed.skipped > 0 {
            return Err(ServerError::Io {
                path: folder.to_owned(),
                source: io::Error::other("a file of a new capture changed while it was kept"),
            });
        }
        Ok(pushed.kept)
    }
}
