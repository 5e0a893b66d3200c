//! An uploaded capture: a folder or a zip of photographs, assessed file by file.
//!
//! Photographs are directly in the capture, in `images/` or where `place` finds them; sharp ground
//! truth with the same names is in `gt/` (or `HL/`, as in LuSh-NeRF); poses, if given, are where
//! `pose_files` finds them. Poses are located here, and read only to find the largest of several
//! models. Wrapper folders are looked through; hidden files are ignored.

mod archive;
mod assess;
mod budget;
mod entries;
mod error;
mod folders;
mod heads;
mod layout;
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
pub use look::on_few_threads;
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

/// What a file of poses has for the photographs of its capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    /// Those of its photographs.
    Placed(PlacedPoses),
    /// None, since their file cannot be read or assigned.
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
    /// What the user should know about the capture as a whole.
    pub warnings: Vec<CaptureWarning>,
    /// Poses uploaded with it.
    pub poses: Option<CapturePoses>,
    /// Every n-th photograph is held out unless the options say otherwise: a file `hold=8`, as in
    /// published sets.
    pub hold: Option<u32>,
    /// blake3 of names and contents: equal for equal captures, wherever they are stored.
    pub fingerprint: String,
}

/// The assessment of an upload whose images are not prepared.
#[derive(Clone, Debug, PartialEq)]
pub struct Inspection {
    /// Number of photographs that can be used.
    pub accepted: usize,
    /// As [`Capture::photographs`].
    pub photographs: Vec<PhotoPath>,
    /// As [`Capture::assessments`].
    pub assessments: Vec<Assessment>,
    /// As [`Capture::warnings`].
    pub warnings: Vec<CaptureWarning>,
    /// As [`Capture::poses`].
    pub poses: Option<CapturePoses>,
}

impl Inspection {
    /// Inspects a folder or a zip. A zip is unpacked to `unpacked/` under `scratch_dir` (recreated,
    /// and removed again on failure); a folder stays where it is. Every photograph is decoded once;
    /// an unusable one is rejected on its own.
    ///
    /// # Errors
    /// [`CaptureError`]; [`CaptureError::TooFew`] carries the assessments.
    pub fn of(path: &Path, scratch_dir: &Path, watch: &Watch<'_>) -> Result<Self, CaptureError> {
        let layout = layout(path, scratch_dir)?;
        let assessed = assess::assess(&layout, watch, None).map_err(CaptureError::io(path))?;
        let Assessed { views, photographs, assessments, warnings } = enough(assessed)?;
        let poses = placed(layout.poses.as_ref(), &photographs, &views)?;
        Ok(Self { accepted: views.len(), photographs, assessments, warnings, poses })
    }
}

impl Capture {
    /// Opens a capture and prepares its images in `prepared/` under `scratch_dir`, at most
    /// [`PREPARED_SIDE`] px; otherwise as [`Inspection::of`]. A capture already prepared there is
    /// not decoded again.
    ///
    /// # Errors
    /// As [`Inspection::of`]; [`CaptureError::Io`] if an image cannot be written.
    pub fn open(path: &Path, scratch_dir: &Path) -> Result<Self, CaptureError> {
        Self::open_at(path, scratch_dir, PREPARED_SIDE)
    }

    /// As [`Capture::open`], with images of at most `side` px.
    ///
    /// # Errors
    /// As [`Capture::open`].
    pub fn open_at(path: &Path, scratch_dir: &Path, side: usize) -> Result<Self, CaptureError> {
        let layout = layout(path, scratch_dir)?;
        let fingerprint = layout.fingerprint()?;
        let contents = format!("{fingerprint} {}", layout.files);
        let preparation = Preparation::new(scratch_dir, side);
        let before = preparation.before(&contents);
        let is_whole = |capture: &Self| capture.is_whole(&preparation.folder);
        if let Some(capture) = before.filter(is_whole) {
            return Ok(capture);
        }
        let failed = || CaptureError::io(&preparation.folder);
        preparation.begin().map_err(failed())?;
        let assessed = assess::assess(&layout, &Watch::nobody(), Some(&preparation))
            .map_err(failed())
            .and_then(enough)
            .inspect_err(|_| preparation.abandon())?;
        let Assessed { views, photographs, assessments, warnings } = assessed;
        let poses = placed(layout.poses.as_ref(), &photographs, &views)
            .inspect_err(|_| preparation.abandon())?;
        let hold = layout.hold;
        let capture = Self { views, photographs, assessments, warnings, poses, hold, fingerprint };
        preparation
            .keep(&contents, &capture)
            .inspect_err(|_| preparation.abandon())
            .map_err(failed())?;
        Ok(capture)
    }

    /// The folder of the prepared images under a scratch folder.
    pub fn prepared(scratch_dir: &Path) -> PathBuf {
        Preparation::new(scratch_dir, PREPARED_SIDE).folder
    }

    /// Whether the files of all prepared images are in this folder and have their sizes.
    fn is_whole(&self, folder: &Path) -> bool {
        let mut images = self
            .views
            .iter()
            .flat_map(|view| [&view.prepared].into_iter().chain(&view.gt).chain(&view.mask));
        images.all(|image| image.is_whole_in(folder))
    }
}

fn layout(path: &Path, scratch_dir: &Path) -> Result<Layout, CaptureError> {
    let metadata = path.metadata().map_err(CaptureError::io(path))?;
    let entries = if metadata.is_dir() {
        entries::of_folder(path)?
    } else if archive::is_zip(path).map_err(CaptureError::io(path))? {
        archive::unpack(path, &scratch_dir.join("unpacked"))?
    } else {
        let path = path.to_owned();
        return Err(match Unread::of(&path).map_err(CaptureError::io(&path))? {
            Some(format) => CaptureError::Unread { path, format },
            None => CaptureError::NotACapture { path },
        });
    };
    Layout::of(entries)
}

/// # Errors
/// [`CaptureError::Io`] if the file of the poses cannot be read at all.
fn placed(
    file: Option<&GivenPosesFile>,
    photographs: &[PhotoPath],
    views: &[CaptureView],
) -> Result<Option<CapturePoses>, CaptureError> {
    let Some(file) = file else {
        return Ok(None);
    };
    let placed = GivenPoses::open(file.path(), photographs).and_then(|given| given.place(views));
    let placement = match placed {
        Ok(placed) => Placement::Placed(placed),
        Err(PoseFileError::BadFile { file, reason }) => {
            Placement::Unusable { file: name_of(&file).into_owned(), reason }
        }
        Err(PoseFileError::Io { path, source }) => return Err(CaptureError::Io { path, source }),
    };
    Ok(Some(CapturePoses { file: file.clone(), placement }))
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
