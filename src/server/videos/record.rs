//! What is known of a video, in a file beside it.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use fled_core::video::Plan;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::data::{DataDir, is_id, write_atomically};
use crate::error::{Result, ServerError};

/// Where a video stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VideoState {
    /// It waits for its turn.
    Queued,
    /// It is made.
    Running,
    /// It is there.
    Succeeded,
    /// It will not be.
    Failed,
}

impl VideoState {
    /// Whether nothing more comes.
    pub fn is_over(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed)
    }
}

/// Why a video failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct VideoFault {
    /// What happened.
    pub detail: String,
    /// What to do.
    pub hint: String,
}

/// What is known of a video.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// UUID v7: later ones are greater.
    pub id: String,
    /// Where it stands.
    pub state: VideoState,
    /// What was asked for.
    pub plan: Plan,
    /// Of its pictures, px.
    pub width: usize,
    /// Of its pictures, px.
    pub height: usize,
    /// When it was asked for, milliseconds.
    pub created_at: i64,
    /// When it was over, milliseconds.
    pub finished_at: Option<i64>,
    /// How often it was begun.
    pub attempts: u32,
    /// How large it is.
    pub bytes: Option<u64>,
    /// Why it failed.
    pub error: Option<VideoFault>,
}

/// The folder of one video.
#[derive(Clone, Debug)]
pub struct VideoFolder(PathBuf);

impl VideoFolder {
    /// Of a job's video, whether it exists or not; `None` for what is no id of one.
    pub fn of(data: &DataDir, job: &str, id: &str) -> Option<Self> {
        is_id(id).then(|| Self(data.videos(job).join(id)))
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// What was asked for, for the process that makes it.
    pub fn plan(&self) -> PathBuf {
        self.0.join("plan.json")
    }

    /// The video.
    pub fn video(&self) -> PathBuf {
        self.0.join("video.mp4")
    }

    /// What is known of it; `None` where there is no such video.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn load(&self) -> Result<Option<Record>> {
        let path = self.record();
        let text = match fs::read(&path) {
            Err(error) if is_gone(&error) => return Ok(None),
            read => read.map_err(ServerError::io(&path))?,
        };
        let damaged = |error: serde_json::Error| ServerError::Damaged {
            what: "video",
            detail: error.to_string(),
        };
        serde_json::from_slice(&text).map(Some).map_err(damaged)
    }

    /// Keeps what is known of it. The folder must be there: who deletes a video deletes that.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save(&self, record: &Record) -> Result<()> {
        let path = self.record();
        let text = serde_json::to_vec(record).map_err(|error| ServerError::Damaged {
            what: "video",
            detail: error.to_string(),
        })?;
        write_atomically(&path, &text).map_err(ServerError::io(&path))
    }

    /// Removes it with its folder; whether it was there.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn remove(&self) -> Result<bool> {
        match fs::remove_dir_all(&self.0) {
            Err(error) if is_gone(&error) => Ok(false),
            removed => removed.map(|()| true).map_err(ServerError::io(&self.0)),
        }
    }

    fn record(&self) -> PathBuf {
        self.0.join("video.json")
    }
}

fn is_gone(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::NotFound
}

/// Every video of a job, newest first.
///
/// # Errors
/// When the folder or a record cannot be read.
pub fn videos_of(data: &DataDir, job: &str) -> Result<Vec<Record>> {
    let folder = data.videos(job);
    let entries = match fs::read_dir(&folder) {
        Err(error) if is_gone(&error) => return Ok(Vec::new()),
        entries => entries.map_err(ServerError::io(&folder))?,
    };
    let mut records = Vec::new();
    for entry in entries {
        let entry = entry.map_err(ServerError::io(&folder))?;
        let name = entry.file_name();
        let video = name.to_str().and_then(|id| VideoFolder::of(data, job, id));
        if let Some(video) = video {
            records.extend(video.load()?);
        }
    }
    records.sort_by(|a: &Record, b| b.id.cmp(&a.id));
    Ok(records)
}
