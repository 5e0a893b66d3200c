//! The file of an upload, which says how much of it there is.

use std::io;

use tokio::fs::File;

use crate::app::App;
use crate::error::ServerError;
use crate::http::problem::Problem;
use crate::store::UploadRow;

/// Opens the file of an upload that nobody else has; with it how many bytes it has.
///
/// # Errors
/// 404 where it is not there.
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

/// Takes everything behind so many bytes away.
///
/// # Errors
/// When the disk refuses.
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

/// Makes what is there survive a power cut.
///
/// # Errors
/// When the disk refuses.
pub(super) async fn sync(app: &App, row: &UploadRow, file: &File) -> Result<(), ServerError> {
    let path = app.data.upload(&row.id);
    file.sync_all().await.map_err(ServerError::io(&path))
}

/// How many bytes there are.
///
/// # Errors
/// When the disk does not say.
pub(super) async fn length(app: &App, row: &UploadRow, file: &File) -> Result<u64, ServerError> {
    let path = app.data.upload(&row.id);
    let about = file.metadata().await.map_err(ServerError::io(&path))?;
    Ok(about.len())
}
