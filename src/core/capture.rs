//! What was uploaded: a folder or a zip of photographs, assessed file by file.
//!
//! Photographs lie directly in the capture, in `images/` or where `place` says; sharp ground truth
//! of the same names in `gt/` (or `HL/`, as LuSh-NeRF has it); poses, where given, where
//! `pose_files` says. Poses are found here, and read only to tell which of several models is the
//! largest. Folders around everything are looked through; hidden files are not seen.

mod archive;
mod assess;
mod budget;
mod entries;
mod error;
mod heads;
mod layout;
mod look;
mod masked;
mod masks;
mod photograph;
mod place;
mod pose_files;
mod twins;
mod versions;
pub mod video;
mod watch;

use std::path::Path;

use crate::image::Unread;
use crate::photo_path::PhotoPath;

pub use archive::{MAX_ARCHIVE_BYTES, unpacked_bytes, write_unpacked};
pub use assess::{FEW_VIEWS, view_names};
pub use budget::DecodeBudget;
pub use entries::NAMES;
pub use error::{ArchiveFault, CaptureError, MAX_FILES, MIN_VIEWS};
pub use layout::GivenPosesFile;
pub use masks::masks_in;
pub use photograph::{Assessment, CaptureView, CaptureWarning};
pub use watch::{Look, Watch};

/// A capture that can be worked on.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// The accepted photographs, in natural order of their names.
    pub views: Vec<CaptureView>,
    /// All photographs that there are, accepted or not, in natural order.
    pub photographs: Vec<PhotoPath>,
    /// What became of each file that claims to be a photograph, accepted or not.
    pub assessments: Vec<Assessment>,
    /// What the user should know about the capture as a whole.
    pub warnings: Vec<CaptureWarning>,
    /// Poses that were uploaded with it.
    pub poses: Option<GivenPosesFile>,
    /// Every how many-th photograph is held out where the options leave it open: a file `hold=8`,
    /// as published sets have it.
    pub hold: Option<u32>,
    /// blake3 of names and contents: equal for equal captures wherever they lie.
    pub fingerprint: String,
}

impl Capture {
    /// Reads a capture from a folder or a zip. A zip is unpacked to `unpacked/` under
    /// `scratch_dir` (made anew, removed again on failure); a folder is left where it is and the
    /// scratch folder is not touched. Every photograph is decoded once; one that cannot be used
    /// is rejected by itself.
    ///
    /// # Errors
    /// [`CaptureError`]; [`CaptureError::TooFew`] carries the assessments.
    pub fn open(path: &Path, scratch_dir: &Path) -> Result<Self, CaptureError> {
        Self::open_watched(path, scratch_dir, &Watch::nobody())
    }

    /// As [`Capture::open`], while somebody watches.
    ///
    /// # Errors
    /// As [`Capture::open`].
    pub fn open_watched(
        path: &Path,
        scratch_dir: &Path,
        watch: &Watch<'_>,
    ) -> Result<Self, CaptureError> {
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
        let layout = layout::Layout::of(entries)?;
        let fingerprint = layout.fingerprint()?;
        let assessed = assess::assess(&layout, watch);
        if assessed.views.len() < MIN_VIEWS {
            return Err(CaptureError::TooFew {
                accepted: assessed.views.len(),
                assessments: assessed.assessments,
            });
        }
        Ok(Self {
            views: assessed.views,
            photographs: assessed.photographs,
            assessments: assessed.assessments,
            warnings: assessed.warnings,
            poses: layout.poses,
            hold: layout.hold,
            fingerprint,
        })
    }
}

#[cfg(test)]
mod tests;
