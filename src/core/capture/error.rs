//! Why a capture or an archive is refused.

use std::path::{Path, PathBuf};

use super::photograph::Assessment;
use super::place::in_words;
use crate::image::Unread;
use crate::poses::LeftOut;
use crate::poses::left_out::in_words as in_words_of;

/// Most files of a capture that are looked at.
pub const MAX_FILES: usize = 20_000;

/// Fewer usable photographs than this are refused: two fix no scene.
pub const MIN_VIEWS: usize = 3;

/// Why a capture cannot be worked on.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The path is neither a folder nor a zip.
    #[error("{} is neither a folder of photographs, a zip nor a video", path.display())]
    NotACapture {
        /// The path.
        path: PathBuf,
    },
    /// The path is a file of a format that is known and not read.
    #[error("{}: {format}", path.display())]
    Unread {
        /// The path.
        path: PathBuf,
        /// Its format.
        format: Unread,
    },
    /// The zip is refused.
    #[error("the zip is refused: {0}")]
    Archive(#[from] ArchiveFault),
    /// There are more files than are taken.
    #[error("more than {MAX_FILES} files")]
    TooManyFiles,
    /// There is no photograph where one is looked for.
    #[error("{}", none(seen, video.as_deref(), result.as_deref()))]
    NoPhotographs {
        /// Folders of pictures that are made of photographs, with how many each has.
        seen: Vec<(String, usize)>,
        /// A video.
        video: Option<String>,
        /// The folder of a result of fled, whose pictures are none.
        result: Option<String>,
    },
    /// Photographs lie in several folders that are not called parts of one scene.
    #[error("photographs lie in several places: {}", in_words(seen))]
    Scattered {
        /// The folders, with how many each has.
        seen: Vec<(String, usize)>,
    },
    /// Too few photographs can be used.
    #[error("{}", too_few(*accepted, assessments))]
    TooFew {
        /// How many can be used.
        accepted: usize,
        /// What became of each file.
        assessments: Vec<Assessment>,
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
    /// Whether the machine is at fault, not the capture.
    pub fn is_of_the_machine(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() != std::io::ErrorKind::NotFound)
    }

    /// What to do about it.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::NotACapture { .. } | Self::Unread { .. } => {
                "give a folder with JPEG, PNG, WebP, TIFF or HEIC photographs, or a zip of one"
            }
            Self::Archive(_) => {
                "zip the folder of photographs anew, without encryption, links or odd paths"
            }
            Self::TooManyFiles => "leave out what is not a photograph, or every second photograph",
            Self::NoPhotographs { seen, .. } if !seen.is_empty() => {
                "move the photographs into a folder images/; depth maps, masks and the like are none"
            }
            Self::NoPhotographs { video: Some(_), .. } => {
                "give the video itself: it is taken apart into photographs"
            }
            Self::Scattered { .. } => {
                "move the photographs of one scene into a folder images/, with folders of their own \
                 if names repeat, or give one of the folders"
            }
            Self::NoPhotographs { .. } | Self::TooFew { .. } => {
                "upload 20 to 60 overlapping photographs of one unmoving scene, each from another place"
            }
            Self::Io { .. } => {
                "check that the path exists, can be read, and that the disk is not full"
            }
        }
    }

    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }
}

/// The sentence of [`CaptureError::NoPhotographs`].
fn none(seen: &[(String, usize)], video: Option<&str>, result: Option<&str>) -> String {
    let mut text = "there is no photograph, in images/ or elsewhere".to_owned();
    if !seen.is_empty() {
        text.push_str(&format!("; pictures lie in {}", in_words(seen)));
    }
    if let Some(video) = video {
        text.push_str(&format!("; there is a video, {video}"));
    }
    if let Some(folder) = result {
        let folder = if folder.is_empty() { "this folder" } else { folder };
        text.push_str(&format!("; {folder} holds a result of fled, whose pictures are not read"));
    }
    text
}

/// The sentence of [`CaptureError::TooFew`], with the reasons.
fn too_few(accepted: usize, assessments: &[Assessment]) -> String {
    let mut text = format!(
        "{accepted} of {} photographs can be used, at least {MIN_VIEWS} are needed",
        assessments.len()
    );
    let refused =
        { assessments.iter() }.filter_map(|v| Some(LeftOut::new(&v.name, v.reason.as_ref()?)));
    let refused: Vec<LeftOut> = refused.collect();
    if !refused.is_empty() {
        text.push_str(&format!("; {}", in_words_of(&refused)));
    }
    text
}

/// Why an archive is refused, and the entry at fault where there is one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{reason}", entry.as_ref().map(|name| format!("{name:?}: ")).unwrap_or_default())]
pub struct ArchiveFault {
    /// The entry's name as packed.
    pub entry: Option<String>,
    /// What is wrong.
    pub reason: String,
}

impl ArchiveFault {
    pub(super) fn whole(reason: impl Into<String>) -> Self {
        Self { entry: None, reason: reason.into() }
    }

    pub(super) fn of(entry: &str, reason: impl Into<String>) -> Self {
        Self { entry: Some(entry.to_owned()), reason: reason.into() }
    }
}
