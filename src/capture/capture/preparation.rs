//! The folder of a prepared capture.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::Capture;
use super::error::CaptureError;
use super::prepared::PreparedImage;
use crate::image::{Image, Linear, write_atomic};

/// Raised when prepared images of equal photographs, or the manifest, change.
const VERSION: u32 = 3;

/// The file that makes a folder a prepared capture.
const MANIFEST: &str = "manifest.json";

/// The end of the names of images.
const IMAGE: &str = ".half";

/// Where a zip is unpacked while it is read.
const UNPACKED: &str = ".unpacked";

/// The start of the names of folders with photographs taken from a video.
const FRAMES: &str = ".frames-";

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

/// What the manifest holds: a prepared capture, and what it was made of.
#[derive(Serialize, Deserialize)]
struct Manifest<C> {
    #[serde(flatten)]
    stamp: Stamp,
    capture: C,
}

/// What a prepared capture was made of.
#[derive(Serialize, Deserialize, PartialEq, Eq)]
struct Stamp {
    fled_capture: u32,
    side: usize,
    /// A digest of the files of the capture.
    contents: String,
}

impl Preparation {
    pub(super) fn new(folder: &Path, side: usize) -> Self {
        Self { folder: folder.to_owned(), side }
    }

    /// Writes an image of photograph `index`.
    pub(super) fn write(
        &self,
        image: &Image<Linear>,
        kind: Kind,
        index: usize,
    ) -> io::Result<PreparedImage> {
        let kind = match kind {
            Kind::View => "view",
            Kind::GroundTruth => "truth",
            Kind::Mask => "mask",
        };
        PreparedImage::write(image, &self.folder.join(format!("{kind}-{index:05}{IMAGE}")))
    }

    /// Where a zip is unpacked while it is read.
    pub(super) fn unpacked(&self) -> PathBuf {
        self.folder.join(UNPACKED)
    }

    /// The capture as it was prepared before, if it was, from the same files.
    pub(super) fn before(&self, contents: &str) -> Option<Capture> {
        let stamp = self.stamp(contents);
        let manifest = manifest(&self.folder).filter(|manifest| manifest.stamp == stamp)?;
        located(manifest.capture, &self.folder)
    }

    /// Whether a folder has a manifest, of any build.
    pub(super) fn is_here(folder: &Path) -> bool {
        let stamp = fs::read(folder.join(MANIFEST)).ok();
        stamp.is_some_and(|bytes| serde_json::from_slice::<Stamp>(&bytes).is_ok())
    }

    /// The capture that was prepared in a folder.
    ///
    /// # Errors
    /// [`CaptureError::Unprepared`].
    pub(super) fn read(folder: &Path) -> Result<Capture, CaptureError> {
        let whole = manifest(folder).filter(|manifest| manifest.stamp.fled_capture == VERSION);
        let whole = whole.and_then(|manifest| located(manifest.capture, folder));
        whole.ok_or_else(|| CaptureError::Unprepared { path: folder.to_owned() })
    }

    /// Makes the folder, without anything of an earlier preparation.
    ///
    /// # Errors
    /// [`CaptureError::Occupied`], [`CaptureError::Io`].
    pub(super) fn begin(&self) -> Result<(), CaptureError> {
        let failed = || CaptureError::io(&self.folder);
        fs::create_dir_all(&self.folder).map_err(failed())?;
        if let Some(path) = self.entries(|name| !is_ours(name)).map_err(failed())?.pop() {
            return Err(CaptureError::Occupied { path });
        }
        self.remove(is_remade).map_err(failed())
    }

    /// Removes what was unpacked.
    pub(super) fn clear_unpacked(&self) {
        // What is left is removed when the next preparation begins.
        let _ = self.remove(|name| name == UNPACKED);
    }

    /// Removes what was written.
    pub(super) fn abandon(&self) {
        // The error that led here is the one worth reporting.
        let _ = self.remove(is_remade).and_then(|()| fs::remove_dir(&self.folder));
    }

    /// Keeps a capture whose images are all prepared.
    ///
    /// # Errors
    /// [`CaptureError::Io`].
    pub(super) fn keep(&self, contents: &str, capture: &Capture) -> Result<(), CaptureError> {
        let manifest = Manifest { stamp: self.stamp(contents), capture };
        let path = self.folder.join(MANIFEST);
        let written = serde_json::to_vec(&manifest).map_err(io::Error::other);
        let written = written.and_then(|bytes| write_atomic(&path, &bytes));
        written.map_err(CaptureError::io(&path))
    }

    fn stamp(&self, contents: &str) -> Stamp {
        Stamp { fled_capture: VERSION, side: self.side, contents: contents.to_owned() }
    }

    /// The entries of the folder with such names.
    fn entries(&self, is_such: impl Fn(&str) -> bool) -> io::Result<Vec<PathBuf>> {
        let mut entries = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let entry = entry?;
            if is_such(&entry.file_name().to_string_lossy()) {
                entries.push(entry.path());
            }
        }
        Ok(entries)
    }

    fn remove(&self, is_such: impl Fn(&str) -> bool) -> io::Result<()> {
        self.entries(is_such)?.iter().try_for_each(|path| match path.is_dir() {
            true => fs::remove_dir_all(path),
            false => fs::remove_file(path),
        })
    }
}

/// The folder of photographs taken from a video, in the folder where they are prepared.
pub(super) fn frames(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{FRAMES}{name}"))
}

fn is_ours(name: &str) -> bool {
    is_remade(name) || name.starts_with(FRAMES)
}

/// Whether a preparation makes this anew.
fn is_remade(name: &str) -> bool {
    name == UNPACKED || name.ends_with(IMAGE) || name.contains(MANIFEST)
}

fn manifest(folder: &Path) -> Option<Manifest<Capture>> {
    serde_json::from_slice(&fs::read(folder.join(MANIFEST)).ok()?).ok()
}

/// The capture with its images in this folder, if all are whole.
fn located(mut capture: Capture, folder: &Path) -> Option<Capture> {
    capture.images().for_each(|image| image.place_in(folder));
    let is_whole = capture.images().all(|image| image.is_whole());
    is_whole.then_some(capture)
}
