//! What every format tells of one view, and the name it goes by.

use std::path::Path;

use crate::poses::Lens;

/// A pose with the lens it was given with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GivenView {
    pub(super) lens: Lens,
    pub(super) world_to_camera: glam::DMat4,
    /// Nearest and farthest depth, where the format tells.
    pub(super) bounds: Option<(f64, f64)>,
}

/// A file's name without folder and extension.
pub(super) fn stem(file: &Path) -> String {
    file.file_stem()
        .map(|stem| stem.to_string_lossy().into_owned())
        .unwrap_or_default()
}
