//! Photographs out of the videos of an upload.

use std::path::{Path, PathBuf};
use std::time::Duration;

use axum::http::StatusCode;
use fled_core::cancel::CancelToken;
use fled_core::capture::MIN_VIEWS;
use fled_core::capture::video::{FRAMES, MOST_FRAMES, VideoError, Wanted, take_frames};

use super::Upload;
use super::places::{PHOTOGRAPHS, VIDEOS};
use crate::app::App;
use crate::error::ServerError;
use crate::http::problem::{Problem, disk_full};
use crate::http::quota::over_quota;
use crate::intake::{ARCHIVE, Assessment, CaptureReport, Warning};

/// An upload waits so long for the videos of others, seconds.
const TURN_S: u32 = 60;

/// What is told of videos, beside what is told of photographs.
#[derive(Debug, Default)]
pub(super) struct Videos {
    unused: Vec<Assessment>,
    warnings: Vec<Warning>,
}

impl Videos {
    /// Adds it to what is told.
    pub(super) fn add_to(self, report: &mut CaptureReport) {
        report.images.extend(self.unused);
        report.warnings.extend(self.warnings);
    }
}

/// Stops the reading of a video when nobody waits for it any more.
struct UntilDropped(CancelToken);

impl Drop for UntilDropped {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

impl Upload {
    /// Makes photographs of the video that came, where nothing else came: a phone writes a short
    /// one beside every photograph. The video stays beside the photographs.
    ///
    /// # Errors
    /// 415 where there is no ffmpeg, 422 for a video that cannot be read and for several, 503 while
    /// those of others are read, 507 when there is no room.
    pub(super) async fn take_frames(&self, app: &App) -> Result<Videos, Problem> {
        let (dir, into) = (self.dir.path(), self.dir.path().join(PHOTOGRAPHS));
        let videos = files(&dir.join(VIDEOS))?;
        if videos.is_empty() {
            return Ok(Videos::default());
        }
        if dir.join(ARCHIVE).is_file() || !files(&into)?.is_empty() {
            let unused = videos.iter().map(|video| unused(video)).collect();
            return Ok(Videos {
                unused,
                ..Videos::default()
            });
        }
        let [video] = &videos[..] else {
            let detail = format!("There are {} videos.", videos.len());
            return Err(Problem::unprocessable("bad_input", detail)
                .hint("Send one: a capture is one walk. Each of the others makes its own."));
        };
        let count = self.frames()?;
        // Each takes processors and a process; uploads wait for each other, for a while.
        let turn =
            tokio::time::timeout(Duration::from_secs(TURN_S.into()), app.filming.lock()).await;
        let _turn = turn.map_err(|_| busy())?;
        let name = name_of(video);
        let until_dropped = UntilDropped(CancelToken::new());
        let cancel = until_dropped.0.clone();
        let room = app.free_space().min(self.most.unwrap_or(u64::MAX));
        let (dir, program) = (self.dir.clone(), app.config.ffmpeg.clone());
        let video = video.clone();
        let work = move || {
            // Who looks at the files holds the folder, also when the client hangs up.
            let _dir = dir;
            let stem = video.file_stem().unwrap_or_default().to_string_lossy();
            let wanted = Wanted {
                count,
                into: &into,
                stem: &stem,
                room,
            };
            take_frames(&program, &video, &wanted, &cancel)
        };
        let taken = tokio::task::spawn_blocking(work)
            .await
            .map_err(|_| Problem::internal())?;
        let taken = match taken {
            Err(VideoError::NoRoom { .. }) if self.most.is_some_and(|most| most <= room) => {
                return Err(over_quota());
            }
            Err(VideoError::NoRoom { .. }) => return Err(disk_full()),
            taken => taken.map_err(|error| refused(&error, &name))?,
        };
        Ok(Videos {
            warnings: vec![Warning {
                code: "video".to_owned(),
                message: taken.told(&name),
            }],
            ..Videos::default()
        })
    }

    /// How many photographs are wanted of the video.
    fn frames(&self) -> Result<usize, Problem> {
        let Some(text) = self.fields.get("frames").filter(|text| !text.is_empty()) else {
            return Ok(FRAMES);
        };
        let count = text.parse().ok();
        count
            .filter(|count| (MIN_VIEWS..=MOST_FRAMES).contains(count))
            .ok_or_else(|| {
                let detail = "`frames` is no number of photographs to take of a video.";
                Problem::unprocessable("bad_input", detail)
                    .pointer("/frames")
                    .hint(format!("From {MIN_VIEWS} to {MOST_FRAMES}."))
            })
    }
}

/// The files of a folder that may not be there, in order.
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

fn name_of(video: &Path) -> String {
    let name = video.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

fn unused(video: &Path) -> Assessment {
    Assessment {
        name: name_of(video),
        accepted: false,
        reason: Some("photographs came with it; a video is used where it comes alone".to_owned()),
        width: 0,
        height: 0,
        focal_px: None,
        warnings: Vec::new(),
    }
}

fn busy() -> Problem {
    let detail = "The videos of others are being read.";
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", detail)
        .hint("Send it again in a few minutes.")
        .retry_after(TURN_S)
}

fn refused(error: &VideoError, name: &str) -> Problem {
    let problem = match error {
        VideoError::Io { .. } => {
            tracing::error!(%error, "cannot take frames of a video");
            return Problem::internal();
        }
        VideoError::Missing { .. } => {
            tracing::warn!(%error, "a video came");
            let detail = format!("{name}: videos are not read here, there is no ffmpeg.");
            Problem::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "unsupported_format",
                detail,
            )
        }
        error => Problem::unprocessable("bad_input", format!("{name}: {error}.")),
    };
    problem.hint(error.hint())
}
