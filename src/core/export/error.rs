//! Why there is no export.

use std::io;
use std::path::{Path, PathBuf};

use crate::gaussians::ply::PlyError;

/// Why there is no export.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// There is no picture of any view.
    #[error("{}: no pictures of views with a camera", .0.display())]
    NoPictures(PathBuf),
    /// The cameras cannot be read.
    #[error("{}: {source}", path.display())]
    Cameras {
        /// The file.
        path: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] PlyError),
    /// Something that it is made of cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Whoever takes it takes no more.
    #[error("it cannot be written: {0}")]
    Write(io::Error),
}

impl ExportError {
    pub(super) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }

    /// Whether something that it is made of is not there.
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
