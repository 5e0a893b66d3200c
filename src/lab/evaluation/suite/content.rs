//! Hashes of the content of files, independent of location and time.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::error::SuiteError;

/// blake3 of a file, or of a folder's files with their paths, in hex.
///
/// # Errors
/// [`SuiteError::Io`].
pub fn checksum(path: &Path) -> Result<String, SuiteError> {
    if !fs::metadata(path).map_err(SuiteError::io(path))?.is_dir() {
        let mut hasher = blake3::Hasher::new();
        File::open(path)
            .and_then(|file| hasher.update_reader(file).map(|_| ()))
            .map_err(SuiteError::io(path))?;
        return Ok(hasher.finalize().to_hex().to_string());
    }
    let mut files = Vec::new();
    walk(path, Path::new(""), &mut files)?;
    files.sort();
    let listing = files
        .into_iter()
        .map(|file| {
            let content = checksum(&path.join(&file))?;
            Ok((file.to_string_lossy().into_owned(), content))
        })
        .collect::<Result<Vec<_>, SuiteError>>()?;
    Ok(hashed(&listing))
}

/// Lists every file below a folder, by its relative path.
fn walk(folder: &Path, below: &Path, files: &mut Vec<PathBuf>) -> Result<(), SuiteError> {
    let here = folder.join(below);
    for entry in fs::read_dir(&here).map_err(SuiteError::io(&here))? {
        let below = below.join(entry.map_err(SuiteError::io(&here))?.file_name());
        let path = folder.join(&below);
        // Links are followed.
        if fs::metadata(&path).map_err(SuiteError::io(&path))?.is_dir() {
            walk(folder, &below, files)?;
        } else {
            files.push(below);
        }
    }
    Ok(())
}

/// blake3 of a value's JSON, in hex.
pub fn hashed(value: &impl Serialize) -> String {
    let text = serde_json::to_vec(value).expect("maps have text as keys, and numbers are finite");
    blake3::hash(&text).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("temporary folder");
        for (name, text) in files {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().expect("a folder")).expect("folder");
            fs::write(path, text).expect("file");
        }
        folder
    }

    #[test]
    fn a_folders_hash_depends_on_names_and_contents_only() {
        let sum = |files: &[(&str, &str)]| checksum(folder(files).path()).expect("readable");
        let first = sum(&[("images/1.png", "a"), ("2.png", "b")]);
        assert_eq!(first, sum(&[("2.png", "b"), ("images/1.png", "a")]));
        assert_ne!(first, sum(&[("images/1.png", "a"), ("2.png", "c")]));
        assert_ne!(first, sum(&[("images/1.png", "a"), ("3.png", "b")]));
        assert_ne!(first, sum(&[("images/1.png", "a")]));
    }

    #[test]
    fn an_error_names_the_missing_file() {
        let error = checksum(Path::new("/nowhere/at/all")).expect_err("missing");
        assert!(error.to_string().starts_with("/nowhere/at/all: "));
    }
}
