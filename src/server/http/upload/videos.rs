//! Photographs from the videos of an upload.

use std::path::{Path, PathBuf};
use std::time::Duration;

use axum::http::StatusCode;
use fled_core::capture::video::{FRAMES, MOST_FRAMES};
use fled_core::capture::{Assessment, MIN_VIEWS};
use tokio::sync::MutexGuard;

use super::Upload;
use super::places::{PHOTOGRAPHS, VIDEOS};
use crate::app::App;
use crate::error::ServerError;
use crate::http::problem::Problem;
use crate::validation::ARCHIVE;
use crate::validator::{Filming, VideoFault, VideoFaultKind};

/// How long an upload waits for other videos to be read, in seconds.
const TURN_S: u32 = 60;

/// The videos of an upload.
#[derive(Debug, Default)]
pub(super) struct Videos {
    /// The video that photographs are taken from.
    pub(super) used: Option<Filming>,
    /// Assessments of the other videos.
    pub(super) unused: Vec<Assessment>,
}

impl Upload {
    /// Decides how to use the videos. Photographs are taken from a video only if nothing else was
    /// sent: a phone stores a short one beside every photograph. The video is kept with its
    /// photographs.
    ///
    /// # Errors
    /// 422 for several videos.
    pub(super) fn videos(&self, app: &App) -> Result<Videos, Problem> {
        let (dir, into) = (self.dir.path(), self.dir.path().join(PHOTOGRAPHS));
        let videos = files(&dir.join(VIDEOS))?;
        if videos.is_empty() {
            return Ok(Videos::default());
        }
        if dir.join(ARCHIVE).is_file() || !files(&into)?.is_empty() {
            let unused = videos.iter().map(|video| unused(video)).collect();
            return Ok(Videos { used: None, unused });
        }
        let [video] = &videos[..] else {
            let detail = format!("The upload has {} videos.", videos.len());
            return Err(
                Problem::unprocessable("bad_input", detail).hint("Send one video per capture.")
            );
        };
        let used = Some(Filming {
            file: video.clone(),
            into,
            frames: self.frames()?,
            ffmpeg: app.config.ffmpeg.clone(),
        });
        Ok(Videos { used, unused: Vec::new() })
    }

    /// The number of photographs to take from the video.
    fn frames(&self) -> Result<usize, Problem> {
        let Some(text) = self.fields.get("frames").filter(|text| !text.is_empty()) else {
            return Ok(FRAMES);
        };
        let count = text.parse().ok();
        count.filter(|count| (MIN_VIEWS..=MOST_FRAMES).contains(count)).ok_or_else(|| {
            let detail = "`frames` is not a valid number of photographs to take from a video.";
            Problem::unprocessable("bad_input", detail)
                .pointer("/frames")
                .hint(format!("Send a number from {MIN_VIEWS} to {MOST_FRAMES}."))
        })
    }
}

/// The files of a folder, sorted; none if it does not exist.
fn files(folder: &Path) -> Result<Vec<PathBuf>, Problem> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(ServerError::io(folder))?,
    };
    let mut files = Vec::new();
    for entry in entries {
        files.push(entry.map_err(ServerError::io(folder))?.path());
    }
    files.sort();
    Ok(files)
}

pub(super) fn name_of(video: &Path) -> String {
    let name = video.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

fn unused(video: &Path) -> Assessment {
    let reason = "a video is used only on its own, and photographs were sent with it";
    Assessment::refused(name_of(video), reason.to_owned())
}

/// A turn to read a video. Each takes processors and a process, so uploads wait for each other for
/// a limited time.
///
/// # Errors
/// 503 while other videos are being read.
pub(super) async fn turn(app: &App) -> Result<MutexGuard<'_, ()>, Problem> {
    let patience = Duration::from_secs(TURN_S.into());
    let turn = tokio::time::timeout(patience, app.filming.lock()).await;
    turn.map_err(|_| busy())
}

fn busy() -> Problem {
    let detail = "Other videos are being read.";
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", detail)
        .hint("Try again in a few minutes.")
        .retry_after(TURN_S)
}

/// The problem if no photographs could be taken from the video `name`.
pub(super) fn not_filmed(fault: &VideoFault, name: &str) -> Problem {
    let detail = &fault.detail;
    let problem = match fault.kind {
        VideoFaultKind::Ours => {
            tracing::error!(detail, "cannot take frames from a video");
            return Problem::internal();
        }
        VideoFaultKind::Missing => {
            tracing::warn!(detail, "a video was sent, but ffmpeg is missing");
            let detail =
                format!("{name}: this server cannot read videos, because ffmpeg is missing.");
            Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_format", detail)
        }
        VideoFaultKind::NoRoom | VideoFaultKind::Video => {
            Problem::unprocessable("bad_input", format!("{name}: {detail}."))
        }
    };
    problem.hint(fault.hint.clone())
}
