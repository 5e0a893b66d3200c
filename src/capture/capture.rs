//! An uploaded capture: a folder or a zip of photographs, assessed file by file.
//!
//! Photographs are directly in the capture, in `images/` or where `place` finds them; sharp ground
//! truth with the same names is in `gt/` (or `HL/`, as in LuSh-NeRF); poses, if given, are where
//! `pose_files` finds them. Wrapper folders are looked through; hidden files are ignored.

mod archive;
mod assess;
mod budget;
mod entries;
mod error;
mod folders;
mod heads;
mod layout;
mod limits;
mod look;
mod masked;
mod masks;
mod photograph;
mod place;
mod pose_files;
mod preparation;
mod prepared;
mod print;
mod twins;
mod versions;
pub mod video;
mod watch;
mod white_balances;

use std::fs::File;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::dataset::{GivenPoses, PlacedPoses};
use crate::image::Unread;
use crate::photo_path::PhotoPath;
use crate::poses::{PoseFileError, name_of};
use assess::Assessed;
use layout::Layout;
use preparation::Preparation;

pub use archive::{MAX_ARCHIVE_BYTES, unpacked_bytes, write_unpacked};
pub use assess::{FEW_VIEWS, view_names};
pub use budget::DecodeBudget;
pub use entries::NAMES;
pub use error::{ArchiveFault, CaptureError, MAX_FILES, MIN_VIEWS};
pub use folders::is_of_a_run;
pub use limits::{PHOTOGRAPH_TIME, READER_MEMORY, limit_reader, reader_memory};
pub use look::{ASSESSED_SIDE, on_few_threads};
pub use masks::masks_in;
pub use photograph::{Assessment, CaptureView, CaptureWarning};
pub use pose_files::GivenPosesFile;
pub use prepared::{PREPARED_SIDE, PreparedImage};
pub use watch::{Look, Watch};

/// The poses that came with a capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CapturePoses {
    /// The file that they are in.
    pub file: GivenPosesFile,
    /// The poses.
    pub placement: Placement,
}

/// The outcome of assigning a pose file to the photographs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    /// Each photograph that the file covers has its pose.
    Placed(PlacedPoses),
    /// The file cannot be read or assigned.
    Unusable {
        /// The file's name, for messages.
        file: String,
        /// The fault.
        reason: String,
    },
}

/// A capture that can be processed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Capture {
    /// The accepted photographs, in natural order of their names.
    pub views: Vec<CaptureView>,
    /// All photographs in the capture, accepted or not, in natural order.
    pub photographs: Vec<PhotoPath>,
    /// The outcome for each file that claims to be a photograph, accepted or not.
    pub assessments: Vec<Assessment>,
    /// Warnings about the capture as a whole.
    pub warnings: Vec<CaptureWarning>,
    /// Poses uploaded with it.
    pub poses: Option<CapturePoses>,
    /// Every n-th photograph is held out unless the options say otherwise: a file `hold=8`, as in
    /// published sets.
    pub hold: Option<u32>,
    /// blake3 of names and contents: equal for equal captures, wherever they are stored.
    pub fingerprint: String,
}

impl Capture {
    /// Prepares a capture in `prepared/` under `scratch_dir`, with images of at most
    /// [`PREPARED_SIDE`] px.
    ///
    /// # Errors
    /// As [`Capture::prepare`].
    pub fn open(path: &Path, scratch_dir: &Path) -> Result<Self, CaptureError> {
        Self::open_at(path, scratch_dir, PREPARED_SIDE)
    }

    /// As [`Capture::open`], with images of at most `side` px.
    ///
    /// # Errors
    /// As [`Capture::prepare`].
    pub fn open_at(path: &Path, scratch_dir: &Path, side: usize) -> Result<Self, CaptureError> {
        Self::prepare(path, &scratch_dir.join("prepared"), side, &Watch::silent())
    }

    /// Prepares a capture: writes its images, with a longest side of at most `side` px, and a
    /// manifest into `out`, a folder that is new, empty or of an earlier preparation. A capture
    /// already prepared there is not decoded again. A zip is unpacked there while it is read.
    ///
    /// # Errors
    /// [`CaptureError`]; [`CaptureError::TooFew`] carries the assessments, and
    /// [`CaptureError::Occupied`] is for a folder with other files.
    pub fn prepare(
        path: &Path,
        out: &Path,
        side: usize,
        watch: &Watch<'_>,
    ) -> Result<Self, CaptureError> {
        let preparation = Preparation::new(out, side);
        let source = Source::of(path)?;
        let (contents, fingerprint) = source.contents()?;
        preparation.expect_free()?;
        let lock = preparation.lock()?;
        if let Some(capture) = preparation.before(&contents) {
            return Ok(capture);
        }
        preparation.begin()?;
        let prepared = source.layout(&preparation.unpacked()).and_then(|layout| {
            let capture = Self::of(&layout, fingerprint, &preparation, watch)?;
            preparation.keep(&contents, &capture)?;
            Ok(capture)
        });
        preparation.clear_unpacked();
        if prepared.is_err() {
            preparation.abandon();
        }
        drop(lock);
        prepared
    }

    fn of(
        layout: &Layout,
        fingerprint: Option<String>,
        preparation: &Preparation,
        watch: &Watch<'_>,
    ) -> Result<Self, CaptureError> {
        let fingerprint = fingerprint.map_or_else(|| layout.fingerprint(), Ok)?;
        let assessed = assess::assess(layout, watch, preparation)
            .map_err(CaptureError::io(&preparation.folder))?;
        let Assessed { views, photographs, assessments, warnings } = enough(assessed)?;
        let poses = placed(layout.poses.as_ref(), &photographs, &views);
        let hold = layout.hold;
        Ok(Self { views, photographs, assessments, warnings, poses, hold, fingerprint })
    }

    /// Whether a folder holds a prepared capture.
    pub fn is_prepared(folder: &Path) -> bool {
        Preparation::is_here(folder)
    }

    /// Reads the prepared capture in a folder, which may have been moved.
    ///
    /// # Errors
    /// [`CaptureError::Unprepared`] if there is none of this build, whole.
    pub fn prepared(folder: &Path) -> Result<Self, CaptureError> {
        Preparation::read(folder)
    }

    /// As [`Capture::prepared`], for one that a user gives in place of photographs. Its fingerprint
    /// is that of the manifest, so cached poses of the photographs themselves are not used.
    ///
    /// # Errors
    /// As [`Capture::prepared`].
    pub fn given(folder: &Path) -> Result<Self, CaptureError> {
        let fingerprint = Preparation::digest(folder)?;
        Ok(Self { fingerprint, ..Preparation::read(folder)? })
    }

    /// Checks that a capture may be prepared in a folder, and makes it.
    ///
    /// # Errors
    /// [`CaptureError::Occupied`], [`CaptureError::Io`].
    pub fn expect_free(out: &Path) -> Result<(), CaptureError> {
        Preparation::new(out, PREPARED_SIDE).expect_free()
    }

    /// Removes a prepared capture, but not photographs taken from a video.
    ///
    /// # Errors
    /// [`CaptureError::Io`].
    pub fn discard(folder: &Path) -> Result<(), CaptureError> {
        Preparation::new(folder, PREPARED_SIDE).discard().map_err(CaptureError::io(folder))
    }

    /// Removes the photographs taken from videos.
    pub fn discard_frames(out: &Path) {
        Preparation::new(out, PREPARED_SIDE).clear_frames();
    }

    /// Checks that the prepared images are as large as a run with images of at most `side` px
    /// needs.
    ///
    /// # Errors
    /// [`CaptureError::TooSmall`].
    pub fn expect_side(&self, side: usize) -> Result<(), CaptureError> {
        let is_small = |view: &&CaptureView| {
            let prepared = view.prepared.width.max(view.prepared.height);
            prepared < side.min(view.width.max(view.height))
        };
        match self.views.iter().find(is_small) {
            Some(view) => {
                let prepared = view.prepared.width.max(view.prepared.height);
                Err(CaptureError::TooSmall { prepared, side })
            }
            None => Ok(()),
        }
    }

    /// The folder of the photographs taken from a video, in the folder where they are prepared.
    pub fn frames(out: &Path, name: &str) -> PathBuf {
        preparation::frames(out, name)
    }

    /// The images that were prepared.
    fn images(&mut self) -> impl Iterator<Item = &mut PreparedImage> {
        self.views.iter_mut().flat_map(|view| {
            [&mut view.prepared].into_iter().chain(&mut view.gt).chain(&mut view.mask)
        })
    }
}

/// A folder or a zip.
enum Source<'a> {
    Folder(Box<Layout>),
    Zip(&'a Path),
}

impl<'a> Source<'a> {
    fn of(path: &'a Path) -> Result<Self, CaptureError> {
        let metadata = path.metadata().map_err(CaptureError::io(path))?;
        if metadata.is_dir() {
            let layout = Layout::of(entries::of_folder(path)?)?;
            return Ok(Self::Folder(Box::new(layout)));
        }
        if archive::is_zip(path).map_err(CaptureError::io(path))? {
            return Ok(Self::Zip(path));
        }
        let path = path.to_owned();
        Err(match Unread::of(&path).map_err(CaptureError::io(&path))? {
            Some(format) => CaptureError::Unread { path, format },
            None => CaptureError::NotACapture { path },
        })
    }

    /// A digest of all that is read, and the fingerprint if it is known without unpacking.
    fn contents(&self) -> Result<(String, Option<String>), CaptureError> {
        match self {
            Self::Folder(layout) => {
                let fingerprint = layout.fingerprint()?;
                Ok((format!("{fingerprint} {}", layout.files), Some(fingerprint)))
            }
            Self::Zip(path) => {
                let mut hasher = blake3::Hasher::new();
                let file = File::open(path).map_err(CaptureError::io(path))?;
                hasher.update_reader(file).map_err(CaptureError::io(path))?;
                Ok((format!("zip {}", hasher.finalize().to_hex()), None))
            }
        }
    }

    /// A zip is unpacked to this folder.
    fn layout(self, unpacked: &Path) -> Result<Layout, CaptureError> {
        match self {
            Self::Folder(layout) => Ok(*layout),
            Self::Zip(path) => Layout::of(archive::unpack(path, unpacked)?),
        }
    }
}

/// The poses of these photographs in the file that came along.
fn placed(
    file: Option<&GivenPosesFile>,
    photographs: &[PhotoPath],
    views: &[CaptureView],
) -> Option<CapturePoses> {
    let file = file?;
    let placed = GivenPoses::open(file.path(), photographs).and_then(|given| given.place(views));
    let placement = match placed {
        Ok(placed) => Placement::Placed(placed),
        Err(PoseFileError::BadFile { file, reason }) => {
            Placement::Unusable { file: name_of(&file).into_owned(), reason }
        }
        Err(PoseFileError::Io { path, source }) => {
            Placement::Unusable { file: name_of(&path).into_owned(), reason: source.to_string() }
        }
    };
    Some(CapturePoses { file: file.clone(), placement })
}

/// # Errors
/// [`CaptureError::TooFew`].
fn enough(assessed: Assessed) -> Result<Assessed, CaptureError> {
    if assessed.views.len() < MIN_VIEWS {
        return Err(CaptureError::TooFew {
            accepted: assessed.views.len(),
            assessments: assessed.assessments,
        });
    }
    Ok(assessed)
}

#[cfg(test)]
mod tests;
