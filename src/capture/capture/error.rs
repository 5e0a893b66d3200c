//! Why a capture or an archive is refused.

use std::path::{Path, PathBuf};

use super::photograph::Assessment;
use crate::image::Unread;
use crate::poses::LeftOut;
use crate::poses::left_out::in_words as in_words_of;

/// Maximum number of files in a capture.
pub const MAX_FILES: usize = 20_000;

/// Captures with fewer usable photographs are refused: two do not determine a scene.
pub const MIN_VIEWS: usize = 3;

/// Why a capture cannot be processed.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The path is neither a folder nor a zip.
    #[error("{} is neither a folder of photographs, a zip nor a video", path.display())]
    NotACapture {
        /// The path.
        path: PathBuf,
    },
    /// The path is a file in a known but unsupported format.
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
    /// There are more files than the limit.
    #[error("more than {MAX_FILES} files")]
    TooManyFiles,
    /// No photograph was found.
    #[error("{}", none(seen, video.as_deref(), result.as_deref()))]
    NoPhotographs {
        /// Folders of pictures derived from photographs, each with its count.
        seen: Vec<(String, usize)>,
        /// A video.
        video: Option<String>,
        /// The folder of a fled result, whose pictures are not photographs.
        result: Option<String>,
    },
    /// Photographs are in several folders whose names do not make them parts of one scene.
    #[error("photographs lie in several places: {}", in_words(seen))]
    Scattered {
        /// The folders, each with its count.
        seen: Vec<(String, usize)>,
    },
    /// Too few photographs are usable.
    #[error("{}", too_few(*accepted, assessments))]
    TooFew {
        /// Number of usable photographs.
        accepted: usize,
        /// The outcome for each file.
        assessments: Vec<Assessment>,
    },
    /// The folder for a prepared capture has files of something else.
    #[error("{} is not part of a prepared capture", path.display())]
    Occupied {
        /// One of them.
        path: PathBuf,
    },
    /// A prepared capture cannot be used.
    #[error("{} is not a complete capture prepared by this build of fled", path.display())]
    Unprepared {
        /// Its folder.
        path: PathBuf,
    },
    /// A prepared capture is too small for a run.
    #[error("the capture is prepared at {prepared} px, and the run needs {side}")]
    TooSmall {
        /// Longest side of its images, px.
        prepared: usize,
        /// Longest side of the images of the run, px.
        side: usize,
    },
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
}

impl CaptureError {
    /// Whether the machine is at fault rather than the capture.
    pub fn is_of_the_machine(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() != std::io::ErrorKind::NotFound)
    }

    /// Whether the disk is full.
    pub fn is_full(&self) -> bool {
        use std::io::ErrorKind::{QuotaExceeded, StorageFull};
        matches!(self, Self::Io { source, .. }
            if matches!(source.kind(), StorageFull | QuotaExceeded))
    }

    /// A remedy for the user.
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
            Self::Occupied { .. } => "give a new or empty folder",
            Self::Unprepared { .. } => "prepare the photographs again with `fled prepare`",
            Self::TooSmall { .. } => {
                "prepare the photographs again with a larger `--size`, or run with a smaller `size`"
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

/// The message of [`CaptureError::NoPhotographs`].
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

/// The message of [`CaptureError::TooFew`], with the reasons.
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

/// Why an archive is refused, with the entry at fault if there is one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{reason}", entry.as_ref().map(|name| format!("{name:?}: ")).unwrap_or_default())]
pub struct ArchiveFault {
    /// The entry's name in the archive.
    pub entry: Option<String>,
    /// The reason.
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

/// "garden/ (12 pictures) and kitchen/ (1 picture)".
pub(super) fn in_words(places: &[(String, usize)]) -> String {
    const MOST_LISTED: usize = 5;
    let one = |(folder, count): &(String, usize)| {
        let folder = match folder.as_str() {
            "" => "the capture's own folder".to_owned(),
            folder => format!("{folder}/"),
        };
        format!("{folder} ({count} picture{})", if *count == 1 { "" } else { "s" })
    };
    let mut listed: Vec<String> = places.iter().take(MOST_LISTED).map(one).collect();
    if places.len() > MOST_LISTED {
        listed.push(format!("{} more folders", places.len() - MOST_LISTED));
    }
    listed.join(" and ")
}
