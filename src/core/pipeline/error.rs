//! Errors that end a run, classified by what the caller should do.

use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::config::OptionsError;
use crate::cancel::Cancelled;
use crate::capture::CaptureError;
use crate::deblur::DeblurError;
use crate::gaussians::ply::PlyError;
use crate::image::ImageError;
use crate::poses::{PoseFileError, PosesError};
use crate::reconstruct::ReconstructError;
use crate::render::SplatError;
use fled_gpu::GpuError;

/// The kind of a failure; it alone decides exit code, HTTP status and retry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorKind {
    /// The capture or its options cannot be used.
    BadInput,
    /// Too few photographs could be registered.
    FewPoses,
    /// Main memory ran out.
    OomHost,
    /// GPU memory ran out.
    OomGpu,
    /// The GPU device was lost.
    DeviceLost,
    /// Reading or writing failed.
    Io,
    /// A tool exceeded its time limit.
    Timeout,
    /// A tool, library, model or adapter is missing or unusable.
    Environment,
    /// The caller cancelled the run.
    Cancelled,
    /// A bug in fled.
    Internal,
}

impl ErrorKind {
    /// The snake_case name used in events, SQL and HTTP.
    pub fn name(self) -> &'static str {
        match self {
            Self::BadInput => "bad_input",
            Self::FewPoses => "few_poses",
            Self::OomHost => "oom_host",
            Self::OomGpu => "oom_gpu",
            Self::DeviceLost => "device_lost",
            Self::Io => "io",
            Self::Timeout => "timeout",
            Self::Environment => "environment",
            Self::Cancelled => "cancelled",
            Self::Internal => "internal",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        [
            Self::BadInput,
            Self::FewPoses,
            Self::OomHost,
            Self::OomGpu,
            Self::DeviceLost,
            Self::Io,
            Self::Timeout,
            Self::Environment,
            Self::Cancelled,
            Self::Internal,
        ]
        .into_iter()
        .find(|kind| kind.name() == name)
    }

    /// Exit code of the command line; 2 means wrong usage, from clap.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::BadInput | Self::FewPoses => 3,
            Self::Environment => 4,
            _ => 1,
        }
    }

    /// Advice that fits every failure of this kind.
    pub fn hint(self) -> &'static str {
        match self {
            Self::BadInput => "Correct the capture or the options, then try again.",
            Self::FewPoses => {
                "Take 20 to 60 photographs that overlap by two thirds, hold the camera steadier, \
                 and avoid blank walls."
            }
            Self::OomHost => "Close other programs or choose a smaller `size`.",
            Self::OomGpu => "Choose a smaller `size` or `cap`, or another `adapter`.",
            Self::DeviceLost => "The GPU driver was reset. Try again: finished stages are kept.",
            Self::Io => "Remove the cause that the message names, then try again.",
            Self::Timeout => "The machine may be overloaded. Try again: finished stages are kept.",
            Self::Environment => "Run `fled doctor` to see what is missing and how to get it.",
            Self::Cancelled => "Start it again to continue where it stopped.",
            Self::Internal => {
                "Please report this with log.txt. Try again: finished stages are kept."
            }
        }
    }

    /// Whether a retry without changes can succeed.
    pub fn retryable(self) -> bool {
        !matches!(self, Self::BadInput | Self::FewPoses | Self::Environment | Self::Cancelled)
    }
}

/// The reason why a run ended without a result.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// An option is unknown or does not fit the capture.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The capture cannot be used.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A photograph could not be read again.
    #[error("{name}: {source}")]
    Photograph {
        /// Name of the view.
        name: String,
        /// The reason.
        source: ImageError,
    },
    /// No poses were found.
    #[error(transparent)]
    Poses(#[from] PosesError),
    /// Fewer views with a pose than a scene needs.
    #[error("only {registered} of {views} photographs have a pose; at least {needed} are needed")]
    TooFewViews {
        /// Views with a pose that can train.
        registered: usize,
        /// Views of the capture.
        views: usize,
        /// The minimum.
        needed: usize,
    },
    /// The deblurring network failed.
    #[error(transparent)]
    Deblur(#[from] DeblurError),
    /// Training failed.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// Rendering failed.
    #[error(transparent)]
    Render(#[from] SplatError),
    /// A scene file that cannot be read or written.
    #[error(transparent)]
    Ply(#[from] PlyError),
    /// Reading or writing the workspace failed.
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    /// The caller cancelled the run.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl PipelineError {
    pub fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Options(_) | Self::Photograph { .. } => ErrorKind::BadInput,
            Self::Capture(error) if error.is_of_the_machine() => ErrorKind::Io,
            Self::Capture(_) => ErrorKind::BadInput,
            Self::TooFewViews { .. } => ErrorKind::FewPoses,
            Self::Poses(error) => poses_kind(error),
            Self::Deblur(error) => deblur_kind(error),
            Self::Reconstruct(error) => reconstruct_kind(error),
            Self::Render(error) => splat_kind(error),
            Self::Ply(_) | Self::Io { .. } => ErrorKind::Io,
            Self::Cancelled(_) => ErrorKind::Cancelled,
        }
    }

    /// Advice for the user.
    pub fn hint(&self) -> String {
        match self {
            Self::Options(_) => {
                "See `fled run --help` or GET /v1/options for the options and their ranges."
                    .to_owned()
            }
            Self::Poses(PosesError::TooFew { advice, .. }) => advice.clone(),
            Self::Capture(error) => error.hint().to_owned(),
            Self::Io { source, .. } => io_hint(source.kind()).to_owned(),
            other => other.kind().hint().to_owned(),
        }
    }
}

fn io_hint(kind: io::ErrorKind) -> &'static str {
    match kind {
        io::ErrorKind::NotFound => {
            "Something removed the file while it was needed. Start again with a new output folder."
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "Make the folder writable for this user, then try again."
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "Free some disk space, then try again."
        }
        _ => ErrorKind::Io.hint(),
    }
}

fn deblur_kind(error: &DeblurError) -> ErrorKind {
    match error {
        DeblurError::UnknownModel { .. } => ErrorKind::BadInput,
        DeblurError::Runtime(_)
        | DeblurError::ModelUnreadable { .. }
        | DeblurError::ModelUnusable { .. }
        | DeblurError::SelfTest { .. } => ErrorKind::Environment,
        DeblurError::GuideSize { .. } | DeblurError::Inference { .. } => ErrorKind::Internal,
    }
}

fn poses_kind(error: &PosesError) -> ErrorKind {
    match error {
        PosesError::TooFew { .. } => ErrorKind::FewPoses,
        PosesError::Missing { .. } => ErrorKind::Environment,
        PosesError::Timeout { .. } => ErrorKind::Timeout,
        PosesError::Tool { .. } | PosesError::Matching { .. } => ErrorKind::Internal,
        PosesError::File(PoseFileError::BadFile { .. }) => ErrorKind::BadInput,
        PosesError::File(PoseFileError::Io { .. }) => ErrorKind::Io,
        PosesError::Cancelled(_) => ErrorKind::Cancelled,
    }
}

fn gpu_kind(error: &GpuError) -> ErrorKind {
    match error {
        GpuError::NoAdapter { .. } => ErrorKind::Environment,
        GpuError::OutOfMemory { .. } | GpuError::TooLarge { .. } => ErrorKind::OomGpu,
        GpuError::DeviceLost(_) => ErrorKind::DeviceLost,
        GpuError::Timeout { .. } => ErrorKind::Timeout,
        GpuError::Shader { .. } | GpuError::Binding { .. } | GpuError::Validation(_) => {
            ErrorKind::Internal
        }
    }
}

fn reconstruct_kind(error: &ReconstructError) -> ErrorKind {
    match error {
        ReconstructError::Gpu(error) => gpu_kind(error),
        ReconstructError::Cancelled(_) => ErrorKind::Cancelled,
        ReconstructError::Empty { .. } => ErrorKind::BadInput,
        ReconstructError::OtherRound
        | ReconstructError::Noise(_)
        | ReconstructError::NotFinite { .. } => ErrorKind::Internal,
    }
}

fn splat_kind(error: &SplatError) -> ErrorKind {
    match error {
        SplatError::Gpu(error) => gpu_kind(error),
        _ => ErrorKind::Internal,
    }
}
