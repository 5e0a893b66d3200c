//! What the service and the process that looks at an upload say to each other, a JSON line each.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::validation::{Assessment, Refusal, Warning};

/// An upload that is to be looked at: the only line to the process but for the answer to
/// [`AssessReply::Needs`], the bytes that it may decode at a time.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AssessRequest {
    /// Its folder.
    pub dir: PathBuf,
    /// The video that photographs are taken of first.
    pub video: Option<Filming>,
    /// What may be written, bytes.
    pub room: u64,
    /// What the process may take of the machine's memory, as address space, bytes.
    pub memory: u64,
}

/// A video, and what is wanted of it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Filming {
    /// Its file.
    pub file: PathBuf,
    /// The folder for the photographs.
    pub into: PathBuf,
    /// How many photographs.
    pub frames: usize,
    /// The program that reads videos.
    pub ffmpeg: PathBuf,
}

/// What the process says. The last is one of `Accepted`, `Refused`, `NotFilmed` and `NoRoom`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AssessReply {
    /// Photographs were taken of the video: which.
    Filmed(String),
    /// No photographs came of the video.
    NotFilmed(VideoFault),
    /// What is unpacked would take more than there is room for.
    NoRoom,
    /// The photographs that are decoded at a time take so many bytes at most. Waits for an answer.
    Needs(u64),
    /// This photograph is looked at. If the process dies, it may be why.
    Begins(String),
    /// That is over.
    Ended(String),
    /// What became of one file, in order.
    Image(Assessment),
    /// The upload is a capture.
    Accepted {
        /// Usable photographs.
        accepted: u32,
        /// What is worth knowing of it as a whole.
        warnings: Vec<Warning>,
    },
    /// It is none. The assessments were told before.
    Refused(Refusal),
}

/// Why no photographs came of a video.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct VideoFault {
    /// Who or what is at fault.
    pub kind: VideoFaultKind,
    /// In one sentence.
    pub detail: String,
    /// What to do about it.
    pub hint: String,
}

/// Who or what is at fault where no photographs come of a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VideoFaultKind {
    /// There is no ffmpeg.
    Missing,
    /// There is no room for the photographs.
    NoRoom,
    /// The machine.
    Ours,
    /// The video.
    Video,
}
