//! The files of networks: built in, or in a folder of models.

use std::path::{Path, PathBuf};

use crate::deblur::DeblurError;

/// The files that are part of the binary, by the manifest's file name.
const EMBEDDED: [(&str, &[u8]); 4] = [
    (
        "small-u2w16.onnx",
        include_bytes!("../../../../models/small-u2w16.onnx"),
    ),
    (
        "small-u2w16.golden",
        include_bytes!("../../../../models/small-u2w16.golden"),
    ),
    (
        "medium-u2w32.onnx",
        include_bytes!("../../../../models/medium-u2w32.onnx"),
    ),
    (
        "medium-u2w32.golden",
        include_bytes!("../../../../models/medium-u2w32.golden"),
    ),
];

/// Where a network's file is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Part of this program.
    BuiltIn,
    /// In a folder of models.
    File(PathBuf),
    /// Not on this machine.
    Missing,
}

pub(super) fn embedded(name: Option<&str>) -> Option<&'static [u8]> {
    EMBEDDED
        .iter()
        .find(|(file, _)| Some(*file) == name)
        .map(|(_, bytes)| *bytes)
}

pub(super) fn find(name: Option<&str>, directories: &[PathBuf]) -> Option<PathBuf> {
    let name = name?;
    directories
        .iter()
        .map(|directory| directory.join(name))
        .find(|path| path.is_file())
}

/// A plain name: neither a path nor a way out of its folder.
pub(super) fn is_file_name(name: &str) -> bool {
    !name.is_empty() && Path::new(name).file_name().is_some_and(|last| last == name)
}

pub(super) fn read(path: &Path) -> Result<Vec<u8>, DeblurError> {
    std::fs::read(path).map_err(|source| DeblurError::ModelUnreadable {
        path: path.to_path_buf(),
        source,
    })
}
