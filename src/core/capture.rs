//! What was uploaded: a folder or a zip of photographs, judged file by file.
//!
//! Photographs lie directly in the capture or in `images/`; sharp ground truth of the same stems
//! in `gt/` (or `HL/`, as LuSh-NeRF has it); poses, where given, as a COLMAP model in `sparse/0/`
//! or `sparse/`, as `transforms.json` or as `poses_bounds.npy`. Poses are found here, not read.
//! One folder around everything is looked through; hidden files are not seen.

mod archive;
mod entries;
mod judge;
mod layout;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::pipeline::error::ErrorKind;

pub use archive::{ArchiveFault, MAX_ARCHIVE_BYTES};
pub use entries::MAX_FILES;
pub use layout::GivenPosesFile;

/// Fewer usable photographs than this are refused: two fix no scene.
pub const MIN_VIEWS: usize = 3;

/// Below this many a capture is accepted with a warning.
pub const FEW_VIEWS: usize = 12;

/// A capture that can be worked on.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// The accepted photographs, in natural order of their names.
    pub views: Vec<CaptureView>,
    /// What became of each file that claims to be a photograph, accepted or not.
    pub verdicts: Vec<Verdict>,
    /// What the user should know about the capture as a whole.
    pub warnings: Vec<CaptureWarning>,
    /// Poses that were uploaded with it.
    pub poses: Option<GivenPosesFile>,
    /// blake3 of names and contents: equal for equal captures wherever they lie.
    pub fingerprint: String,
}

/// One accepted photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct CaptureView {
    /// Our own name: letters, digits, `-`, `_`, at most 40, unique also where case is ignored.
    pub name: String,
    /// The file's name as uploaded; what given poses call it. Never a path of ours.
    pub original_name: String,
    /// Where it lies.
    pub file: PathBuf,
    /// Width of the upright photograph, px.
    pub width: usize,
    /// Height of the upright photograph, px.
    pub height: usize,
    /// Focal length in px, from EXIF.
    pub focal_px: Option<f64>,
    /// Its sharp ground truth.
    pub gt: Option<PathBuf>,
}

/// What became of one file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The name as uploaded.
    pub name: String,
    /// Whether it is used.
    pub accepted: bool,
    /// Why not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Whether its format is known but not read (HEIC, raw): HTTP 415 rather than 422.
    #[serde(default, skip)]
    pub unsupported_format: bool,
    /// Width of the upright photograph, px; 0 when it could not be read.
    pub width: usize,
    /// Height of the upright photograph, px; 0 when it could not be read.
    pub height: usize,
    /// Focal length in px, from EXIF.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_px: Option<f64>,
    /// What the user should know about it.
    pub warnings: Vec<CaptureWarning>,
}

/// Something worth knowing that does not stop the work.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaptureWarning {
    /// Stable snake_case code: `dark`, `blurred`, `mixed_sizes`, `few`, `gt_size`, `gt_missing`.
    pub code: String,
    /// One sentence, with figures.
    pub message: String,
}

impl CaptureWarning {
    fn new(code: &str, message: impl Into<String>) -> Self {
        Self {
            code: code.to_owned(),
            message: message.into(),
        }
    }
}

/// Why a capture cannot be worked on.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The path is neither a folder nor a zip.
    #[error("{} is neither a folder of photographs nor a zip", path.display())]
    NotACapture {
        /// The path.
        path: PathBuf,
    },
    /// The zip is refused.
    #[error("the zip is refused: {0}")]
    Archive(#[from] ArchiveFault),
    /// There are more files than are taken.
    #[error("more than {MAX_FILES} files")]
    TooManyFiles,
    /// Too few photographs can be used.
    #[error("{}", too_few(*accepted, verdicts))]
    TooFew {
        /// How many can be used.
        accepted: usize,
        /// What became of each file.
        verdicts: Vec<Verdict>,
    },
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
}

impl CaptureError {
    /// Who is at fault: the capture, or the machine.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } if source.kind() != std::io::ErrorKind::NotFound => {
                ErrorKind::Io
            }
            _ => ErrorKind::BadInput,
        }
    }

    /// What to do about it.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::NotACapture { .. } => {
                "give a folder with JPEG, PNG, WebP or TIFF photographs, or a zip of one"
            }
            Self::Archive(_) => {
                "zip the folder of photographs anew, without encryption, links or odd paths"
            }
            Self::TooManyFiles => "leave out what is not a photograph, or every second photograph",
            Self::TooFew { .. } => {
                "upload 20 to 60 overlapping photographs of one unmoving scene, each from another place"
            }
            Self::Io { .. } => {
                "check that the path exists, can be read, and that the disk is not full"
            }
        }
    }

    fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }
}

/// The sentence of [`CaptureError::TooFew`], with the first reasons.
fn too_few(accepted: usize, verdicts: &[Verdict]) -> String {
    let mut text = format!(
        "{accepted} of {} photographs can be used, at least {MIN_VIEWS} are needed",
        verdicts.len()
    );
    let rejected = verdicts
        .iter()
        .filter_map(|v| v.reason.as_ref().map(|reason| (&v.name, reason)));
    for (name, reason) in rejected.take(3) {
        text.push_str(&format!("; {name}: {reason}"));
    }
    text
}

impl Capture {
    /// Reads a capture from a folder or a zip. A zip is unpacked to `unpacked/` under
    /// `scratch_dir` (made anew, removed again on failure); a folder is left where it is and the
    /// scratch folder is not touched. Every photograph is decoded once; one that cannot be used
    /// is rejected by itself.
    ///
    /// # Errors
    /// [`CaptureError`]; [`CaptureError::TooFew`] carries the verdicts.
    pub fn open(path: &Path, scratch_dir: &Path) -> Result<Self, CaptureError> {
        let metadata = path.metadata().map_err(CaptureError::io(path))?;
        let entries = if metadata.is_dir() {
            entries::of_folder(path)?
        } else if archive::is_zip(path).map_err(CaptureError::io(path))? {
            archive::unpack(path, &scratch_dir.join("unpacked"))?
        } else {
            return Err(CaptureError::NotACapture {
                path: path.to_owned(),
            });
        };
        let layout = layout::Layout::of(entries);
        let fingerprint = layout.fingerprint()?;
        let judged = judge::judge(&layout);
        if judged.views.len() < MIN_VIEWS {
            return Err(CaptureError::TooFew {
                accepted: judged.views.len(),
                verdicts: judged.verdicts,
            });
        }
        Ok(Self {
            views: judged.views,
            verdicts: judged.verdicts,
            warnings: judged.warnings,
            poses: layout.poses,
            fingerprint,
        })
    }
}

#[cfg(test)]
mod tests;
