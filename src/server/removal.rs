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
