//! Files and folders that COLMAP writes.

use std::path::{Path, PathBuf};

use crate::poses::PosesError;
use crate::poses::model::SparseModel;

/// COLMAP numbers its models in order of creation: the first is not always the largest.
pub(super) fn largest_model(output: &Path) -> Result<Option<SparseModel>, PosesError> {
    let entries = std::fs::read_dir(output).map_err(PosesError::io(output))?;
    let mut dirs: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|dir| SparseModel::stands_in(dir))
        .collect();
    dirs.sort();
    let models = dirs.iter().map(|dir| SparseModel::read(dir)).collect::<Result<Vec<_>, _>>()?;
    let ranked = models.into_iter().filter(|model| !model.images.is_empty());
    Ok(ranked.max_by_key(|model| (model.images.len(), model.points.len())))
}

/// Makes a folder, or removes what an earlier search left in it.
pub(super) fn empty(folder: &Path) -> Result<(), PosesError> {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => std::fs::create_dir_all(folder),
    }
    .map_err(PosesError::io(folder))
}

/// Removes a database and the files beside it.
pub(super) fn remove_if_there(file: &Path) -> Result<(), PosesError> {
    for suffix in ["", "-wal", "-shm", "-journal"] {
        let path = PathBuf::from(format!("{}{suffix}", file.display()));
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(PosesError::io(&path)(error));
            }
            _ => {}
        }
    }
    Ok(())
}
