//! Why a video yields no photographs, and the video limits.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::cancel::Cancelled;
use crate::capture::error::MIN_VIEWS;
use crate::ffmpeg::last_line;
use crate::image::Unread;

/// Maximum number of frames of a video: ten minutes at 60 a second.
pub(super) const MOST_IN_VIDEO: usize = 36_000;

/// Total time limit for ffmpeg. A client waits ten minutes for the response to an upload.
pub(super) const PATIENCE: Duration = Duration::from_secs(8 * 60);

/// Why a video yields no photographs.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// There is no ffmpeg.
    #[error("videos are read by ffmpeg, which cannot be started: {program}: {reason}")]
    Missing {
        /// The command.
        program: String,
        /// The system's message.
        reason: String,
    },
    /// A file in a known but unsupported format.
    #[error("{0}")]
    Unread(Unread),
    /// Only sound or other data.
    #[error("there is no picture in the file, only sound or other data")]
    NoPicture,
    /// Pictures in an unsupported coding.
    #[error("the video is coded in a way that is not read; ffmpeg says: {said}")]
    Codec {
        /// The last line from ffmpeg.
        said: String,
    },
    /// A 360-degree panorama, according to the file's own description.
    #[error("the video is a panorama of 360 degrees ({projection}), which no one camera takes")]
    Sphere {
        /// ffmpeg's name for the projection.
        projection: String,
    },
    /// Two moments in each frame, which this ffmpeg cannot separate.
    #[error(
        "the video is interlaced, and this ffmpeg has neither `bwdif` nor `yadif` to deinterlace it"
    )]
    Interlaced,
    /// ffmpeg cannot read it.
    #[error("the video cannot be read: {reason}")]
    Unreadable {
        /// The reason, and ffmpeg's message.
        reason: String,
    },
    /// The video is too short.
    #[error("the video has {frames} frames, at least {} are needed", MIN_VIEWS)]
    TooShort {
        /// Its number of frames.
        frames: usize,
    },
    /// The video is too long.
    #[error("the video has more than {MOST_IN_VIDEO} frames")]
    TooLong,
    /// Its frames could exceed the available space.
    #[error("the photographs may take {bytes} bytes, more than there is room for")]
    NoRoom {
        /// The size that they may reach.
        bytes: u64,
    },
    /// ffmpeg took too long.
    #[error("ffmpeg was stopped after {} minutes", PATIENCE.as_secs() / 60)]
    Timeout,
    /// Cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
}

impl VideoError {
    /// The error for the last line that ffmpeg wrote.
    pub(super) fn of_ffmpeg(said: &str) -> Self {
        let last = last_line(said);
        if said.contains("matches no streams") {
            return Self::NoPicture;
        }
        if said.contains("not on whitelist") || said.contains("Decoder not found") {
            return Self::Codec { said: last.to_owned() };
        }
        let meaning = if said.contains("moov atom not found") {
            "it is cut short, or no MP4 or MOV: its index is missing"
        } else if said.contains("exceeds specified max pixel count") {
            "its frames are larger than 40 megapixels"
        } else {
            "it is damaged, or no MP4 or MOV"
        };
        Self::Unreadable { reason: format!("{meaning} (ffmpeg says: {last})") }
    }

    /// A remedy for the user.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Missing { .. } => {
                "install it (apt-get install ffmpeg), or give photographs of the video"
            }
            Self::Unread(_) => "give an MP4 or MOV, or photographs of the scene",
            Self::NoPicture => "give the video itself, or photographs of the scene",
            Self::Codec { .. } => "export it as MP4 with H.264",
            Self::Sphere { .. } => {
                "export flat (reframed) views of 60 to 100 degrees from it, as video or photographs"
            }
            Self::Interlaced => {
                "install a complete ffmpeg (apt-get install ffmpeg), or deinterlace the video"
            }
            Self::Unreadable { .. } => "give it as MP4 or MOV that other players show, whole",
            Self::TooShort { .. } => "walk around the scene, slowly, for half a minute or more",
            Self::TooLong => "cut it: ten minutes at 60 frames a second are read",
            Self::NoRoom { .. } => "ask for fewer frames, or make room",
            Self::Timeout => "cut it into parts, or make it smaller",
            Self::Cancelled(_) => "",
            Self::Io { .. } => "check that the disk is not full",
        }
    }

    pub(super) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }
}
