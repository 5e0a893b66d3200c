//! ONNX files, with the files of weights beside them.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::iter;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use super::session::Graph;
use super::wire::weight_files;
use super::{digest, digest_of};

/// A network's files in memory, so that what is hashed is what runs.
#[derive(Clone, Debug, Default)]
pub struct OnnxFile {
    /// SHA-256 of the ONNX file followed by its files of weights in the order of their names, in
    /// hexadecimal digits.
    pub sha256: String,
    bytes: Vec<u8>,
    weights: BTreeMap<String, Arc<[u8]>>,
}

/// The reason why a network's files cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum OnnxFileError {
    /// The ONNX file or its weights cannot be read.
    #[error(transparent)]
    Unreadable(#[from] io::Error),
    /// It is not an ONNX file, or its weights are not in a permitted place.
    #[error("{0}")]
    Unusable(String),
}

impl OnnxFile {
    /// Reads an ONNX file, and the files of weights that it names, below its own folder.
    ///
    /// # Errors
    /// [`OnnxFileError`]; a missing file of weights is named.
    pub fn read(path: &Path) -> Result<Self, OnnxFileError> {
        let bytes = fs::read(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut weights = BTreeMap::new();
        for name in weight_files(&bytes).map_err(OnnxFileError::Unusable)? {
            let file = path_of_weights(folder, &name).map_err(OnnxFileError::Unusable)?;
            weights.insert(name, fs::read(file)?.into());
        }
        let parts =
            iter::once(&*bytes).chain(weights.values().map(|content: &Arc<[u8]>| &**content));
        Ok(Self { sha256: digest_of(parts), bytes, weights })
    }

    /// Checks that an ONNX file and its files of weights exist, without reading the weights.
    ///
    /// # Errors
    /// As [`OnnxFile::read`].
    pub fn check(path: &Path) -> Result<(), OnnxFileError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let names = weight_files(&fs::read(path)?).map_err(OnnxFileError::Unusable)?;
        let mut paths = names.iter().map(|name| path_of_weights(folder, name).map(drop));
        paths.try_for_each(|found| found).map_err(OnnxFileError::Unusable)
    }

    /// A network without other files.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        Self { sha256: digest(bytes), bytes: bytes.to_vec(), weights: BTreeMap::new() }
    }

    /// The network to load.
    pub fn graph(&self) -> Graph<'_> {
        let weights = self.weights.iter().map(|(name, content)| (&**name, content.clone()));
        Graph { bytes: &self.bytes, weights: weights.collect() }
    }
}

/// The path of a file of weights. ONNX allows relative paths that stay below the network's folder.
fn path_of_weights(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let is_below = |part| matches!(part, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || !Path::new(name).components().all(is_below) {
        return Err(format!("its weights lie in `{name}`, not below its own folder: {ONE_FILE}"));
    }
    let path = folder.join(name);
    if path.is_file() {
        return Ok(path);
    }
    Err(format!(
        "its weights lie in `{name}`, which is not beside it: copy that file to its folder, or \
         {ONE_FILE}"
    ))
}

/// PyTorch's option for a network without other files.
pub(super) const ONE_FILE: &str =
    "export the network as one file, as with torch.onnx.export(..., external_data=False)";
