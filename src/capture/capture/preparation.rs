//! The folder of a capture's prepared images.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::image::write_atomic;

/// Raised when prepared images of equal photographs change.
const VERSION: u32 = 2;

/// Where a capture's images are prepared, and how large.
#[derive(Clone, Debug)]
pub(super) struct Preparation {
    pub(super) folder: PathBuf,
    pub(super) side: usize,
}

/// The kinds of prepared images.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    View,
    GroundTruth,
    Mask,
}

/// What `manifest.json` holds: a prepared capture, and what it was made of.
#[derive(Serialize, Deserialize)]
struct Manifest<C> {
    version: u32,
    side: usize,
    /// A digest of the files of the capture.
    contents: String,
    capture: C,
}

impl Preparation {
    pub(super) fn new(scratch: &Path, side: usize) -> Self {
        Self { folder: scratch.join("prepared"), side }
    }

    /// The file of an image of photograph `index`.
    pub(super) fn file(&self, kind: Kind, index: usize) -> PathBuf {
        let kind = match kind {
            Kind::View => "view",
            Kind::GroundTruth => "truth",
            Kind::Mask => "mask",
        };
        self.folder.join(format!("{kind}-{index:05}.half"))
    }

    /// The capture as it was prepared before, if it was, from the same files.
    pub(super) fn before<C: DeserializeOwned>(&self, contents: &str) -> Option<C> {
        let bytes = fs::read(self.manifest()).ok()?;
        let manifest: Manifest<C> = serde_json::from_slice(&bytes).ok()?;
        let of = (manifest.version, manifest.side, &*manifest.contents);
        (of == (VERSION, self.side, contents)).then_some(manifest.capture)
    }

    /// Creates the folder, empty.
    pub(super) fn begin(&self) -> io::Result<()> {
        match fs::remove_dir_all(&self.folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        fs::create_dir_all(&self.folder)
    }

    /// Removes what was written.
    pub(super) fn abandon(&self) {
        // The error that led here is the one worth reporting.
        let _ = fs::remove_dir_all(&self.folder);
    }

    /// Keeps a capture whose images are all prepared. One with a path that is not UTF-8, which JSON
    /// cannot hold, is prepared again next time.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub(super) fn keep(&self, contents: &str, capture: &impl Serialize) -> io::Result<()> {
        let (version, side, contents) = (VERSION, self.side, contents.to_owned());
        match serde_json::to_vec(&Manifest { version, side, contents, capture }) {
            Ok(bytes) => write_atomic(&self.manifest(), &bytes),
            Err(_) => Ok(()),
        }
    }

    fn manifest(&self) -> PathBuf {
        self.folder.join("manifest.json")
    }
}
