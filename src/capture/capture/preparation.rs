//! The folder of a prepared capture.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::assess::view_names;
use super::error::{CaptureError, MIN_VIEWS};
use super::prepared::PreparedImage;
use super::{Capture, Placement};
use crate::image::{Image, Linear, write_atomic};

/// Raised when prepared images of equal photographs, or the manifest, change.
const VERSION: u32 = 4;

/// The file that makes a folder a prepared capture.
const MANIFEST: &str = "manifest.json";

/// The end of the names of images: that of a view's photograph; its ground truth and mask have a
/// word before it.
const IMAGE: &str = ".half";

/// Where a zip is unpacked while it is read.
const UNPACKED: &str = ".unpacked";

/// Locked while a capture is prepared.
const LOCK: &str = ".lock";

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

impl Kind {
    /// The name of a view's image. Names of views contain no dot.
    pub(super) fn file(self, name: &str) -> String {
        match self {
            Self::View => format!("{name}{IMAGE}"),
            Self::GroundTruth => format!("{name}.truth{IMAGE}"),
            Self::Mask => format!("{name}.mask{IMAGE}"),
        }
    }
}

/// The contents of the manifest.
#[derive(Serialize, Deserialize)]
struct Manifest<C> {
    #[serde(flatten)]
    stamp: Stamp,
    capture: C,
}

/// The build and the input that a prepared capture came from.
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

    /// Writes an image of a view, or of a photograph that is not known to be one.
    pub(super) fn write(
        &self,
        image: &Image<Linear>,
        kind: Kind,
        name: &str,
    ) -> io::Result<PreparedImage> {
        let path = self.folder.join(kind.file(name));
        match kind {
            Kind::View | Kind::GroundTruth => PreparedImage::write(image, &path),
            Kind::Mask => PreparedImage::write_grey(image, &path),
        }
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
        let whole = whole.filter(is_sound);
        whole.ok_or_else(|| CaptureError::Unprepared { path: folder.to_owned() })
    }

    /// A digest of the manifest in a folder.
    ///
    /// # Errors
    /// [`CaptureError::Io`].
    pub(super) fn digest(folder: &Path) -> Result<String, CaptureError> {
        let path = folder.join(MANIFEST);
        let bytes = fs::read(&path).map_err(CaptureError::io(&path))?;
        Ok(blake3::hash(&bytes).to_hex().to_string())
    }

    /// Makes the folder, and checks that all in it is of a preparation.
    ///
    /// # Errors
    /// [`CaptureError::Occupied`], [`CaptureError::Io`].
    pub(super) fn expect_free(&self) -> Result<(), CaptureError> {
        let failed = || CaptureError::io(&self.folder);
        fs::create_dir_all(&self.folder).map_err(failed())?;
        match self.entries(|name| !is_ours(name)).map_err(failed())?.pop() {
            Some(path) => Err(CaptureError::Occupied { path }),
            None => Ok(()),
        }
    }

    /// Waits until no other process prepares here, and keeps others waiting until the file is
    /// dropped.
    ///
    /// # Errors
    /// [`CaptureError::Io`].
    pub(super) fn lock(&self) -> Result<File, CaptureError> {
        let path = self.folder.join(LOCK);
        let file = File::create(&path).and_then(|file| file.lock().map(|()| file));
        file.map_err(CaptureError::io(&path))
    }

    /// Removes what an earlier preparation made.
    ///
    /// # Errors
    /// [`CaptureError::Io`].
    pub(super) fn begin(&self) -> Result<(), CaptureError> {
        self.remove(is_remade).map_err(CaptureError::io(&self.folder))
    }

    /// Removes photographs taken from a video.
    pub(super) fn clear_frames(&self) {
        // They are hidden, and the next preparation removes or uses them.
        let _ = self.remove(|name| name.starts_with(FRAMES));
    }

    /// Removes what was unpacked.
    pub(super) fn clear_unpacked(&self) {
        // The next preparation removes leftovers.
        let _ = self.remove(|name| name == UNPACKED);
    }

    /// Removes what was written.
    pub(super) fn abandon(&self) {
        // The error that led here is the one worth reporting.
        let _ = self.discard();
    }

    /// Removes the prepared capture, and the folder if nothing else is in it.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub(super) fn discard(&self) -> io::Result<()> {
        match self.remove(|name| is_remade(name) || name == LOCK) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            outcome => outcome?,
        }
        match fs::remove_dir(&self.folder) {
            Err(error) if error.kind() != io::ErrorKind::DirectoryNotEmpty => Err(error),
            _ => Ok(()),
        }
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
    is_remade(name) || name == LOCK || name.starts_with(FRAMES)
}

/// Whether every preparation replaces this file or folder.
fn is_remade(name: &str) -> bool {
    let is_manifest = name == MANIFEST || (name.starts_with('.') && name.contains(MANIFEST));
    name == UNPACKED || name.ends_with(IMAGE) || is_manifest
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

/// Whether a capture from elsewhere is one that a preparation could have made: names of views
/// become names of files, and later code relies on the rest.
fn is_sound(capture: &Capture) -> bool {
    let names: Vec<&str> = capture.views.iter().map(|view| &*view.name).collect();
    let accepted = capture.assessments.iter().filter(|one| one.accepted).count();
    let placed = capture.poses.iter().filter_map(|poses| match &poses.placement {
        Placement::Placed(placed) => Some(placed),
        Placement::Unusable { .. } => None,
    });
    names.len() >= MIN_VIEWS
        && accepted == names.len()
        && view_names(names.iter().copied()).iter().eq(&names)
        && capture.views.iter().all(|view| view.width.min(view.height) > 0)
        && { placed }.all(|placed| placed.depths.len() == placed.views.len())
}
