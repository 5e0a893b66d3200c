//! Stores an upload as a capture.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use fled_blobs::Kept;
use tokio::sync::MutexGuard;
use uuid::Uuid;

use super::Upload;
use crate::app::App;
use crate::error::ServerError;
use crate::files::data::{bytes_below, sync_directory};
use crate::files::incoming::Incoming;
use crate::files::remove;
use crate::files::upload_locks::UploadLock;
use crate::http::access::Visitor;
use crate::http::problem::Problem;
use crate::http::quota::{bytes_left_beside, over_quota};
use crate::store::CaptureRow;
use crate::validation::CaptureReport;

/// An upload whose files are in their final place and whose row is not stored yet. Until it is
/// dropped, no other quota check ends.
#[derive(Debug)]
pub struct Placed<'a> {
    /// The row.
    pub row: CaptureRow,
    /// The resumable uploads that it was gathered from.
    pub uploads: Vec<String>,
    /// Its files in a shared blob store.
    pub kept: Vec<Kept>,
    files: PathBuf,
    _locks: Vec<UploadLock>,
    _turn: Option<MutexGuard<'a, ()>>,
}

impl Placed<'_> {
    /// Removes the files, because the row was not stored.
    pub async fn give_up(self) {
        remove(&self.files).await;
    }

    /// Removes the files of the resumable uploads: their rows were deleted when this one was
    /// stored.
    pub async fn finish(self, app: &App) -> CaptureRow {
        for id in &self.uploads {
            remove(&app.data.upload(id)).await;
        }
        self.row
    }
}

impl Upload {
    /// Stores the upload as a capture: on disk, fsynced, then in the database.
    ///
    /// # Errors
    /// When a disk or database operation fails; 404 if uploads that it was gathered from no longer
    /// exist.
    pub async fn keep(
        self,
        app: &App,
        report: &CaptureReport,
        visitor: &Visitor,
    ) -> Result<CaptureRow, Problem> {
        let placed = self.place(app, report, visitor).await?;
        let stored = if placed.uploads.is_empty() {
            let stored = app.store.insert_capture(&placed.row, &placed.kept);
            stored.await.map(|()| true)
        } else {
            app.store.insert_capture_of(&placed.row, &placed.kept, &placed.uploads).await
        };
        if !matches!(stored, Ok(true)) {
            placed.give_up().await;
            stored?;
            return Err(Problem::not_found("upload").pointer("/uploads"));
        }
        Ok(placed.finish(app).await)
    }

    /// Moves the files to their final place, fsynced.
    ///
    /// # Errors
    /// When a disk operation fails, or the quota has no room any more.
    pub async fn place<'a>(
        self,
        app: &'a App,
        report: &CaptureReport,
        visitor: &Visitor,
    ) -> Result<Placed<'a>, Problem> {
        // Concurrent uploads of one owner are counted one after another.
        let turn = match self.most {
            Some(_) => Some(self.still_fits(app, visitor).await?),
            None => None,
        };
        let row = CaptureRow {
            id: Uuid::now_v7().to_string(),
            name: self
                .fields
                .get("name")
                .filter(|name| !name.is_empty())
                .cloned()
                .unwrap_or_else(default_name),
            accepted: report.accepted,
            report: serde_json::to_value(report).unwrap_or_default(),
            created_at: app.store.now().await?,
            owner: visitor.owner().map(str::to_owned),
            expires_at: None,
        };
        let to = app.data.capture(&row.id);
        let kept = put(app, &self.dir, &to).await?;
        Ok(Placed {
            row,
            kept,
            uploads: self.used.ids,
            files: to,
            _locks: self.used.locks,
            _turn: turn,
        })
    }

    /// Checks again whether the owner's quota has room. No other check ends before the returned
    /// guard is dropped.
    async fn still_fits<'a>(
        &self,
        app: &'a App,
        visitor: &Visitor,
    ) -> Result<MutexGuard<'a, ()>, Problem> {
        let turn = app.keeping.lock().await;
        let left = bytes_left_beside(app, visitor, self.used.bytes).await?;
        let dir = self.dir.clone();
        let bytes = tokio::task::spawn_blocking(move || bytes_below(dir.path()))
            .await
            .map_err(|_| Problem::internal())?
            .map_err(ServerError::io(self.dir.path()))?;
        if left.is_some_and(|left| bytes + self.beside > left) {
            return Err(over_quota());
        }
        Ok(turn)
    }
}

/// Moves a folder to its final place, fsynced, and returns its files in a shared blob store.
///
/// # Errors
/// When the disk or the blob store fails; then nothing is left in that place.
pub async fn put(app: &App, folder: &Arc<Incoming>, to: &Path) -> Result<Vec<Kept>, Problem> {
    let moved = {
        let (folder, to) = (folder.clone(), to.to_owned());
        tokio::task::spawn_blocking(move || {
            sync_tree(folder.path())?;
            std::fs::rename(folder.path(), &to)?;
            sync_directory(to.parent().unwrap_or(Path::new(".")))
        })
    };
    moved.await.map_err(|_| Problem::internal())?.map_err(ServerError::io(folder.path()))?;
    match app.blob_cache.keep_new(to).await {
        Ok(kept) => Ok(kept),
        Err(error) => {
            remove(to).await;
            Err(error.into())
        }
    }
}

fn default_name() -> String {
    format!("capture of {}", jiff::Zoned::now().strftime("%Y-%m-%d %H:%M"))
}

/// Makes all files and names of a tree survive a power cut. Examining unpacks zips, so the received
/// files are not all there is.
fn sync_tree(dir: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(dir)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_tree(&entry.path())?;
        } else {
            std::fs::File::open(entry.path())?.sync_all()?;
        }
    }
    sync_directory(dir)
}
