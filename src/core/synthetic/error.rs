//! Errors of generating a synthetic capture.

use std::path::PathBuf;

use crate::image::ImageError;
use crate::poses::PoseFileError;

/// The reason why no capture was generated.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// An invalid option.
    #[error("{0}")]
    Options(String),
    /// A photograph for the walls cannot be read.
    #[error("wallpapers: {}: {source}", path.display())]
    Wallpaper {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: ImageError,
    },
    /// An image could not be written.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The poses could not be written.
    #[error(transparent)]
    Poses(#[from] PoseFileError),
    /// A directory could not be created.
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}
