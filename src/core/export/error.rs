//! Why an export failed.

use std::io;
use std::path::{Path, PathBuf};

use crate::gaussians::crop::EmptyCrop;
use crate::gaussians::ply::PlyError;
use crate::image::ImageError;
use crate::mesh::MeshError;

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
    /// A format without a scene cannot be trimmed.
    #[error(
        "{0} holds no scene: crop, scale and degree of the harmonics are for scenes and meshes, \
         such as scene.ply and mesh.glb"
    )]
    NotTrimmed(&'static str),
    /// A mesh has no harmonics.
    #[error("{0} has no harmonics: leave their degree out")]
    NoHarmonics(&'static str),
    /// Only a mesh has triangles and voxels.
    #[error("{0} is not a mesh: triangles and voxel are for mesh.ply and mesh.glb")]
    NoMesh(&'static str),
    /// The mesh cannot be made.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A picture cannot be read.
    #[error(transparent)]
    Picture(#[from] ImageError),
    /// Earlier rounds keep their pictures with 8 bits only.
    #[error(
        "{0} is of the delivered round alone, because pictures of the others have 8 bits: leave \
         the round out, or use `fled render --round N --linear`"
    )]
    OnlyDelivered(&'static str),
    /// An earlier version wrote the restored views.
    #[error(
        "{0} needs restored views of 16 bits, and those of this result have 8: use `fled render \
         --linear`, or run the capture again"
    )]
    EightBits(&'static str),
    /// A crop leaves nothing.
    #[error(transparent)]
    NothingLeft(#[from] EmptyCrop),
    /// The format cannot hold the scene, or not in these units.
    #[error("{0}")]
    Unsuited(io::Error),
    /// The recipient accepts no more data.
    #[error("it cannot be written: {0}")]
    Write(io::Error),
}

impl ExportError {
    pub(super) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }

    /// Why a scene or a mesh was not written: the formats' own errors have no kind.
    pub(super) fn of_format(source: io::Error) -> Self {
        match source.kind() {
            io::ErrorKind::Other => Self::Unsuited(source),
            _ => Self::Write(source),
        }
    }

    /// Whether the wish cannot be met, whatever the result.
    pub fn is_of_wish(&self) -> bool {
        matches!(
            self,
            Self::NotTrimmed(_)
                | Self::NoHarmonics(_)
                | Self::NoMesh(_)
                | Self::OnlyDelivered(_)
                | Self::NothingLeft(_)
                | Self::Unsuited(_)
                | Self::Mesh(
                    MeshError::TooFine { .. } | MeshError::TooMany { .. } | MeshError::TooFew(_)
                )
        )
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
