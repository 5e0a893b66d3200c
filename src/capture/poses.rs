//! The poses of views, and the formats in which they are written.

pub mod bounds;
pub mod left_out;
pub mod lens;
pub mod model;
pub mod npy;
mod rigid;
pub mod text;
pub mod turn;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::image::Image;
pub use left_out::LeftOut;
pub use lens::{Distortion, Lens};
pub(crate) use rigid::{Rotation, rotation};

/// A view with its pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PosedView {
    /// The view's name.
    pub name: String,
    /// The pinhole camera of the *undistorted* photograph, at the original photograph's size.
    pub camera: Camera,
    /// The lens of the photograph as taken.
    pub lens: Lens,
}

impl PosedView {
    /// The photograph (or its ground truth), at any size of the same aspect, as [`Self::camera`]
    /// sees it. Size and encoding stay; without distortion it is a plain copy.
    pub fn undistort<E>(&self, image: &Image<E>) -> Image<E> {
        lens::undistort(image, &self.lens, &self.camera.intrinsics)
    }
}

/// A triangulated point, or a guessed one if poses came without points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SparsePoint {
    /// World units.
    pub position: [f64; 3],
    /// sRGB, at the brightness of the pose copies.
    pub colour: [u8; 3],
    /// Mean reprojection error, px of the pose copies; 0 where unknown.
    pub error: f64,
    /// Number of views that see it; 0 for a guessed point.
    pub track: u32,
}

/// Why a file gives no poses.
#[derive(Debug, thiserror::Error)]
pub enum PoseFileError {
    /// Its content cannot be used.
    #[error("{}: {reason}", name_of(file))]
    BadFile {
        /// The file at fault.
        file: PathBuf,
        /// The fault.
        reason: String,
    },
    /// Reading or writing failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

impl PoseFileError {
    /// An adapter for `map_err` that adds the path.
    pub fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }

    /// A [`PoseFileError::BadFile`].
    pub fn bad_file(file: &Path, reason: impl Into<String>) -> Self {
        Self::BadFile { file: file.to_owned(), reason: reason.into() }
    }
}

/// A file's name for messages, without its path: the owner knows it, and a client of the service
/// need not see our storage path. One of several models is identified by its number in a folder.
pub fn name_of(file: &Path) -> std::borrow::Cow<'_, str> {
    let name = |path: &'_ Path| path.file_name().unwrap_or(path.as_os_str()).to_owned();
    let own = name(file).to_string_lossy().into_owned();
    let is_number = own.bytes().all(|byte| byte.is_ascii_digit());
    match file.parent().filter(|_| is_number) {
        Some(folder) => format!("{}/{own}", name(folder).to_string_lossy()).into(),
        None => own.into(),
    }
}
