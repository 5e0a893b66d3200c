//! Networks: the built-in one, and ONNX files.

use std::path::{Path, PathBuf};

use super::choice::DEFAULT;
use super::{DeblurError, Golden};
use crate::inference::{OnnxFile, OnnxFileError};

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
    /// SHA-256 of the ONNX file and its files of weights, in hexadecimal digits.
    pub sha256: String,
    /// The ONNX file, with its weights.
    pub(super) file: OnnxFile,
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
    /// [`DeblurError::UnknownModel`], [`DeblurError::ModelUnreadable`], or
    /// [`DeblurError::ModelUnusable`] where a file of weights is missing.
    pub fn find(choice: &str, folders: &[PathBuf]) -> Result<Self, DeblurError> {
        if [DEFAULT, BUILT_IN].contains(&choice) {
            return Ok(Self::built_in());
        }
        Self::read(&path_of(choice, folders)?)
    }

    /// Checks that the files of a network that can be chosen by name exist, without reading its
    /// weights.
    ///
    /// # Errors
    /// As [`Model::find`].
    pub fn check(choice: &str, folders: &[PathBuf]) -> Result<(), DeblurError> {
        let path = path_of(choice, folders)?;
        OnnxFile::check(&path).map_err(|error| fault(&path, error))
    }

    fn built_in() -> Self {
        let file = OnnxFile::from_bytes(ONNX);
        Self {
            id: BUILT_IN.to_owned(),
            sha256: file.sha256.clone(),
            file,
            range: RANGE,
            golden: Some(Golden::from_bytes(GOLDEN).expect("a test reads the built-in one")),
        }
    }

    fn read(path: &Path) -> Result<Self, DeblurError> {
        let file = OnnxFile::read(path).map_err(|error| fault(path, error))?;
        Ok(Self {
            id: id_of(path),
            sha256: file.sha256.clone(),
            file,
            range: USUAL_RANGE,
            golden: None,
        })
    }

    /// A copy without the file.
    pub(super) fn without_file(&self) -> Self {
        Self {
            id: self.id.clone(),
            sha256: self.sha256.clone(),
            file: OnnxFile::default(),
            golden: self.golden.clone(),
            ..*self
        }
    }
}

/// The file of a choice that is not built in.
fn path_of(choice: &str, folders: &[PathBuf]) -> Result<PathBuf, DeblurError> {
    // A file in the folders comes first: the service restricts its jobs to these.
    let own = files(folders).into_iter().find(|(name, _)| name == choice);
    let path = own.map_or_else(|| PathBuf::from(choice), |(_, path)| path);
    if path.is_file() {
        return Ok(path);
    }
    Err(DeblurError::UnknownModel {
        choice: choice.to_owned(),
        known: network_names(folders).join(", "),
    })
}

fn id_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn fault(path: &Path, error: OnnxFileError) -> DeblurError {
    match error {
        OnnxFileError::Unreadable(source) => {
            DeblurError::ModelUnreadable { path: path.to_path_buf(), source }
        }
        OnnxFileError::Unusable(detail) => DeblurError::ModelUnusable { id: id_of(path), detail },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn golden(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/onnx").join(name)
    }

    #[test]
    fn default_and_its_own_name_mean_the_built_in_network() {
        let model = Model::find(DEFAULT, &[]).expect("built in");
        assert_eq!(model.id, BUILT_IN);
        let named = Model::find(BUILT_IN, &[]).expect("built in");
        assert_eq!(model.sha256, named.sha256);
        assert_eq!(model.file.graph().bytes, ONNX);
    }

    #[test]
    fn onnx_files_in_the_folder_are_networks_by_name() {
        let home = tempfile::tempdir().expect("temporary directory");
        let folder = home.path().join("models");
        std::fs::create_dir_all(folder.join("folder.onnx")).expect("made");
        for name in ["mine.onnx", "xfeat.pt", "../outside.onnx"] {
            std::fs::copy(golden("identity3.onnx"), folder.join(name)).expect("copied");
        }
        let folders = [folder];
        assert_eq!(network_names(&folders), [BUILT_IN, "mine.onnx"]);
        let mine = Model::find("mine.onnx", &folders).expect("there");
        assert_eq!(mine.id, "mine.onnx");
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
        let path = golden("identity3.onnx");
        let model = Model::find(&path.display().to_string(), &[]).expect("there");
        assert_eq!((model.id.as_str(), model.golden), ("identity3.onnx", None));
    }

    /// `cat external3.onnx weights/external3.data | sha256sum`, of the files beside the tests.
    #[test]
    fn the_digest_covers_the_weights_and_missing_ones_are_named() {
        let home = tempfile::tempdir().expect("temporary directory");
        let network = home.path().join("external3.onnx");
        let weights = home.path().join("weights/external3.data");
        std::fs::copy(golden("external3.onnx"), &network).expect("copied");
        let folders = [home.path().to_owned()];
        let missing = [
            Model::find("external3.onnx", &folders).map(drop),
            Model::check("external3.onnx", &folders),
        ];
        for missing in missing {
            let error = missing.expect_err("no weights").to_string();
            assert!(
                error.contains("network external3.onnx")
                    && error.contains("`weights/external3.data`"),
                "{error}"
            );
        }
        std::fs::create_dir(home.path().join("weights")).expect("made");
        std::fs::copy(golden("weights/external3.data"), &weights).expect("copied");
        Model::check("external3.onnx", &folders).expect("complete");
        let digest = || Model::find("external3.onnx", &folders).expect("complete").sha256;
        let first = digest();
        let read = |path: &Path| std::fs::read(path).expect("read");
        let both = [read(&network), read(&weights)].concat();
        assert_eq!(first, OnnxFile::from_bytes(&both).sha256);
        let mut other = read(&weights);
        other[0] ^= 1;
        std::fs::write(&weights, other).expect("written");
        assert_ne!(digest(), first);
    }

    #[test]
    fn weights_outside_the_networks_folder_are_refused() {
        for (name, file) in [
            ("climbing3.onnx", "`../onnx/weights/external3.data`"),
            ("absolute3.onnx", "`/weights/external3.data`"),
            ("constant3.onnx", "`weights/external3.data`"),
        ] {
            let error = Model::find(&golden(name).display().to_string(), &[]).expect_err(name);
            let words = error.to_string();
            assert!(words.contains(file) && words.contains("external_data=False"), "{words}");
        }
    }
}
