//! Why an export failed.

use std::io;
use std::path::{Path, PathBuf};

use crate::gaussians::ply::PlyError;

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// No view has a picture.
    #[error("{}: no pictures of views with a camera", .0.display())]
    NoPictures(PathBuf),
    /// The cameras cannot be read.
    #[error("{}: {source}", path.display())]
    Cameras {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: serde_json::Error,
    },
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] PlyError),
    /// One of its inputs cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// The system's message.
        source: io::Error,
    },
    /// The recipient accepts no more data.
    #[error("it cannot be written: {0}")]
    Write(io::Error),
}

impl ExportError {
    pub(super) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }

    /// Whether one of its inputs is missing.
    pub fn is_missing(&self) -> bool {
        match self {
            Self::NoPictures(_) => true,
            Self::Io { source, .. } | Self::Scene(PlyError::Io { source, .. }) => {
                source.kind() == io::ErrorKind::NotFound
            }
            _ => false,
        }
    }
}
