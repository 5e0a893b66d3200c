//! The protocol between the service and a validation process, one JSON line per message.

use std::path::PathBuf;

use fled_core::capture::{Assessment, CaptureWarning};
use serde::{Deserialize, Serialize};

use crate::validation::Refusal;

/// A request to validate an upload: the only line sent to the process, apart from answers to
/// [`AssessReply::Needs`], which give the bytes that it may decode at a time.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AssessRequest {
    /// Its folder.
    pub dir: PathBuf,
    /// The video to extract frames from first.
    pub video: Option<Filming>,
    /// Maximum bytes to write.
    pub room: u64,
    /// Maximum address space of the process, in bytes.
    pub memory: u64,
}

/// A video and the frames to extract from it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Filming {
    /// Its file.
    pub file: PathBuf,
    /// The folder for the frames.
    pub into: PathBuf,
    /// Number of frames.
    pub frames: usize,
    /// The FFmpeg program.
    pub ffmpeg: PathBuf,
}

/// A reply of the process. The last one is `Accepted`, `Refused`, `NotFilmed`, `NoRoom` or
/// `Full`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AssessReply {
    /// Frames were extracted from the video; the text describes them.
    Filmed(String),
    /// No frames could be extracted from the video.
    NotFilmed(VideoFault),
    /// The unpacked content would exceed the available space.
    NoRoom,
    /// The disk has no space left.
    Full,
    /// Maximum bytes of concurrently decoded photographs. Waits for an answer.
    Needs(u64),
    /// Validation of this photograph begins. If the process dies, this photograph may be the cause.
    Begins(String),
    /// Validation of this photograph has ended.
    Ended(String),
    /// The assessment of one file, in order.
    Image(Assessment),
    /// The upload is a capture.
    Accepted {
        /// Usable photographs.
        accepted: u32,
        /// Warnings on the capture as a whole.
        warnings: Vec<CaptureWarning>,
    },
    /// The upload is no usable capture. The assessments precede this.
    Refused(Refusal),
}

/// Why no frames could be extracted from a video.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct VideoFault {
    /// The cause.
    pub kind: VideoFaultKind,
    /// What happened, in one sentence.
    pub detail: String,
    /// What to do about it.
    pub hint: String,
}

/// The cause of a failed extraction of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VideoFaultKind {
    /// FFmpeg is missing.
    Missing,
    /// There is too little space for the frames.
    NoRoom,
    /// The machine is at fault.
    Ours,
    /// The video is at fault.
    Video,
}
