//! The files of a folder that become blobs.

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};

use crate::blob::{Blob, Stamp};
use crate::error::{BlobError, Result};

/// Name prefix of files that are still being fetched.
pub(crate) const UNFINISHED: &str = ".fetch-";

/// Number of files hashed, put or fetched concurrently.
pub(crate) const AT_ONCE: usize = 8;

/// A file of a folder, stored as a blob.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Kept {
    /// Relative to the folder, with `/` between names; no name is empty, `.` or `..`.
    pub path: String,
    /// Its content.
    pub blob: Blob,
}

/// The files below a folder.
#[derive(Debug, Default)]
pub(crate) struct Listed {
    /// Relative paths of regular files.
    pub files: BTreeSet<String>,
    /// Files whose names are not UTF-8 and cannot be stored.
    pub nameless: usize,
}

/// Returns whether a name is that of a temporary file, about to be renamed or removed.
pub(crate) fn is_passing(name: &str) -> bool {
    name.starts_with(UNFINISHED) || name.ends_with(".tmp")
}

/// Lists the regular files below a folder, except temporary ones; `None` if the folder does not
/// exist. Symbolic links are not followed. Blocks.
pub(crate) fn list(folder: &Path) -> Result<Option<Listed>> {
    let mut listed = Listed::default();
    let mut waiting = vec![(folder.to_owned(), String::new())];
    while let Some((directory, below)) = waiting.pop() {
        let entries = match std::fs::read_dir(&directory) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                if directory == folder {
                    return Ok(None);
                }
                // Removed since it was listed.
                continue;
            }
            entries => entries.map_err(BlobError::io(&directory))?,
        };
        for entry in entries {
            let entry = entry.map_err(BlobError::io(&directory))?;
            let kind = match entry.file_type() {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                kind => kind.map_err(BlobError::io(&directory))?,
            };
            let name = entry.file_name();
            let Some(name) = name.to_str() else {
                tracing::warn!(path = %entry.path().display(), "a name that is not UTF-8");
                listed.nameless += 1;
                continue;
            };
            let path = format!("{below}{name}");
            if is_passing(name) {
            } else if kind.is_dir() {
                waiting.push((entry.path(), format!("{path}/")));
            } else if kind.is_file() {
                listed.files.insert(path);
            }
        }
    }
    Ok(Some(listed))
}

/// Returns the stamp of a regular file; `None` if there is none. Blocks.
pub(crate) fn stamp(path: &Path) -> Result<Option<Stamp>> {
    use io::ErrorKind::{NotADirectory, NotFound};
    match path.symlink_metadata() {
        Ok(metadata) if metadata.is_file() => Ok(Some(Stamp::of(&metadata))),
        Ok(_) => Ok(None),
        Err(error) if matches!(error.kind(), NotFound | NotADirectory) => Ok(None),
        Err(error) => Err(BlobError::io(path)(error)),
    }
}

/// Returns the path of a stored file in the folder.
///
/// # Errors
/// [`BlobError::Damaged`] if its path could lead out of the folder.
pub(crate) fn place(folder: &Path, path: &str) -> Result<PathBuf> {
    let bad = |name: &str| matches!(name, "" | "." | "..") || name.contains('\0');
    if path.split('/').any(bad) {
        return Err(BlobError::Damaged {
            what: format!("the path {path:?} of a kept file"),
            detail: "it is not relative, or has names that are empty, `.` or `..`".into(),
        });
    }
    Ok(folder.join(path))
}

/// Rejects a file below a symbolic link within the folder. Blocks.
pub(crate) fn expect_no_links(folder: &Path, file: &Path) -> Result<()> {
    let above = file.ancestors().skip(1);
    for directory in above.take_while(|directory| *directory != folder) {
        let metadata = directory.symlink_metadata();
        if metadata.is_ok_and(|metadata| metadata.is_symlink()) {
            return Err(BlobError::Damaged {
                what: directory.display().to_string(),
                detail: "it is a link where a folder of kept files belongs".into(),
            });
        }
    }
    Ok(())
}
