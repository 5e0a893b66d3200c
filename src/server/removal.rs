//! Files of what is no longer in the database.

use std::path::Path;

/// Removes the files of something that is no longer in the database. Their loss of name is what
/// counts; what cannot be removed is told to the operator.
pub async fn remove(dir: &Path) {
    match tokio::fs::remove_dir_all(dir).await {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            tracing::warn!(%error, dir = %dir.display(), "cannot remove");
        }
        _ => {}
    }
}

/// The same for a single file.
pub async fn remove_file(path: &Path) {
    match tokio::fs::remove_file(path).await {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            tracing::warn!(%error, path = %path.display(), "cannot remove");
        }
        _ => {}
    }
}
