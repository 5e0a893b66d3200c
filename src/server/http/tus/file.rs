//! The file of an upload. Its size is the upload's offset.

use std::io;

use tokio::fs::File;

use crate::app::App;
use crate::error::ServerError;
use crate::http::problem::Problem;
use crate::store::UploadRow;

/// Opens the file of an upload that this request has locked, and returns its size in bytes.
///
/// # Errors
/// 404 if it does not exist.
pub(super) async fn open(app: &App, row: &UploadRow) -> Result<(File, u64), Problem> {
    let path = app.data.upload(&row.id);
    let file = match File::options().append(true).open(&path).await {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(Problem::not_found("upload"));
        }
        file => file.map_err(ServerError::io(&path))?,
    };
    let bytes = length(app, row, &file).await?;
    Ok((file, bytes))
}

/// Truncates the file to this many bytes.
///
/// # Errors
/// When a disk operation fails.
pub(super) async fn cut(
    app: &App,
    row: &UploadRow,
    file: &File,
    bytes: u64,
) -> Result<(), ServerError> {
    if length(app, row, file).await? > bytes {
        let path = app.data.upload(&row.id);
        file.set_len(bytes).await.map_err(ServerError::io(&path))?;
    }
    Ok(())
}

/// Makes the content survive a power cut.
///
/// # Errors
/// When a disk operation fails.
pub(super) async fn sync(app: &App, row: &UploadRow, file: &File) -> Result<(), ServerError> {
    let path = app.data.upload(&row.id);
    file.sync_all().await.map_err(ServerError::io(&path))
}

/// The size of the file in bytes.
///
/// # Errors
/// When a disk operation fails.
pub(super) async fn length(app: &App, row: &UploadRow, file: &File) -> Result<u64, ServerError> {
    let path = app.data.upload(&row.id);
    let about = file.metadata().await.map_err(ServerError::io(&path))?;
    Ok(about.len())
}
