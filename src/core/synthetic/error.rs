//! What keeps a capture from being made.

use std::path::PathBuf;

use crate::image::ImageError;
use crate::poses::PosesError;

/// Why nothing was made.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// An option does not fit.
    #[error("{0}")]
    Options(String),
    /// A photograph for the walls cannot be read.
    #[error("wallpapers: {}: {source}", path.display())]
    Wallpaper {
        /// Which.
        path: PathBuf,
        /// Why.
        source: ImageError,
    },
    /// An image could not be written.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The poses could not be written.
    #[error(transparent)]
    Poses(#[from] PosesError),
    /// A directory could not be made.
    #[error("{}: {source}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}
