//! Networks: the built-in one, and ONNX files.

use std::path::{Path, PathBuf};

use super::choice::DEFAULT;
use super::{DeblurError, Golden};
use crate::inference::digest;

/// The built-in network, the meaning of `default`.
pub const BUILT_IN: &str = "small-u2w16";
const ONNX: &[u8] = include_bytes!("../../../models/small-u2w16.onnx");
const GOLDEN: &[u8] = include_bytes!("../../../models/small-u2w16.golden");
const RANGE: [f32; 2] = [-0.5, 1.5];

/// Output range of any other network for values in 0..=1: the bounds of the published NAFNets,
/// beyond which they have failed.
const USUAL_RANGE: [f32; 2] = [-1.0, 2.0];

/// A network ready to be loaded.
#[derive(Clone, Debug)]
pub struct Model {
    /// [`BUILT_IN`] or a file name.
    pub(super) id: String,
    /// SHA-256 of the ONNX file, in hexadecimal digits.
    pub sha256: String,
    /// The ONNX file.
    pub(super) bytes: Vec<u8>,
    /// Least and greatest valid output for input in 0..=1.
    pub(super) range: [f32; 2],
    /// The output that the self-test expects, if known beforehand.
    pub(super) golden: Option<Golden>,
}

/// The networks that can be chosen by name: the built-in one, then the ONNX files in `folders`.
pub fn network_names(folders: &[PathBuf]) -> Vec<String> {
    let own = files(folders).into_iter().map(|(name, _)| name);
    std::iter::once(BUILT_IN.to_owned()).chain(own).collect()
}

/// The ONNX files in `folders` by name, with their paths. Ignores unreadable folders.
fn files(folders: &[PathBuf]) -> Vec<(String, PathBuf)> {
    let entries = folders.iter().filter_map(|folder| folder.read_dir().ok());
    let paths = entries.flatten().flatten().map(|entry| entry.path());
    let mut files: Vec<_> = paths
        .filter(|path| path.extension().is_some_and(|kind| kind == "onnx") && path.is_file())
        .filter_map(|path| Some((path.file_name()?.to_str()?.to_owned(), path)))
        .collect();
    files.sort();
    files
}

impl Model {
    /// Resolves `choice` to a network: `default` or [`BUILT_IN`], the name of an ONNX file in
    /// `folders`, or the path of one.
    ///
    /// # Errors
    /// [`DeblurError::UnknownModel`] or [`DeblurError::ModelUnreadable`].
    pub fn find(choice: &str, folders: &[PathBuf]) -> Result<Self, DeblurError> {
        if [DEFAULT, BUILT_IN].contains(&choice) {
            return Ok(Self::built_in());
        }
        // A file in the folders comes first: the service restricts its jobs to these.
        let own = files(folders).into_iter().find(|(name, _)| name == choice);
        let path = own.map_or_else(|| PathBuf::from(choice), |(_, path)| path);
        if path.is_file() {
            return Self::read(&path);
        }
        Err(DeblurError::UnknownModel {
            choice: choice.to_owned(),
            known: network_names(folders).join(", "),
        })
    }

    fn built_in() -> Self {
        Self {
            id: BUILT_IN.to_owned(),
            sha256: digest(ONNX),
            bytes: ONNX.to_vec(),
            range: RANGE,
            golden: Some(Golden::from_bytes(GOLDEN).expect("a test reads the built-in one")),
        }
    }

    fn read(path: &Path) -> Result<Self, DeblurError> {
        let bytes = std::fs::read(path)
            .map_err(|source| DeblurError::ModelUnreadable { path: path.to_path_buf(), source })?;
        let name = path.file_name().unwrap_or_default();
        Ok(Self {
            id: name.to_string_lossy().into_owned(),
            sha256: digest(&bytes),
            bytes,
            range: USUAL_RANGE,
            golden: None,
        })
    }

    /// A copy without the file.
    pub(super) fn without_bytes(&self) -> Self {
        Self {
            id: self.id.clone(),
            sha256: self.sha256.clone(),
            bytes: Vec::new(),
            golden: self.golden.clone(),
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_and_its_own_name_mean_the_built_in_network() {
        let model = Model::find(DEFAULT, &[]).expect("built in");
        assert_eq!(model.id, BUILT_IN);
        let named = Model::find(BUILT_IN, &[]).expect("built in");
        assert_eq!((model.sha256, model.bytes), (named.sha256, named.bytes));
    }

    #[test]
    fn onnx_files_in_the_folder_are_networks_by_name() {
        let home = tempfile::tempdir().expect("temporary directory");
        let folder = home.path().join("models");
        std::fs::create_dir_all(folder.join("folder.onnx")).expect("made");
        for name in ["mine.onnx", "xfeat.pt", "../outside.onnx"] {
            std::fs::write(folder.join(name), name).expect("written");
        }
        let folders = [folder];
        assert_eq!(network_names(&folders), [BUILT_IN, "mine.onnx"]);
        let mine = Model::find("mine.onnx", &folders).expect("there");
        assert_eq!(
            (mine.id.as_str(), mine.bytes.as_slice()),
            ("mine.onnx", b"mine.onnx".as_slice())
        );
        for choice in ["outside.onnx", "../outside.onnx", "mine", "folder.onnx"] {
            let error = Model::find(choice, &folders).expect_err("none of the folder's");
            assert!(
                matches!(error, DeblurError::UnknownModel { .. })
                    && error.to_string().contains("small-u2w16, mine.onnx"),
                "{error}"
            );
        }
    }

    #[test]
    fn a_path_names_any_file() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("some.onnx");
        std::fs::write(&path, "content").expect("written");
        let model = Model::find(&path.display().to_string(), &[]).expect("there");
        assert_eq!((model.id.as_str(), model.golden), ("some.onnx", None));
    }
}
