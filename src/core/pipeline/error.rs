//! Everything that can end a run, sorted by what the caller should do.

use serde::{Deserialize, Serialize};

/// The kind of a failure decides exit code, HTTP status and retry in one place.
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
    /// A tool did not answer in time.
    Timeout,
    /// A tool, library, model or adapter is missing or unusable.
    Environment,
    /// Asked to stop.
    Cancelled,
    /// A fault of ours.
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

    /// The kind of this name.
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

    /// Exit code of the command line: 2 wrong use is clap's own.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::BadInput | Self::FewPoses => 3,
            Self::Environment => 4,
            _ => 1,
        }
    }

    /// Whether trying again without a change could help.
    pub fn retryable(self) -> bool {
        !matches!(self, Self::BadInput | Self::FewPoses | Self::Environment | Self::Cancelled)
    }
}
