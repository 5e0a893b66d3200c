//! What a worker and a service say to each other by HTTP, as JSON.

use fled_blobs::{Blob, Kept};
use fled_core::event::Event;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use crate::store::{About, Claim, Lease, Machine, Progress, Saying, Settlement};

/// The header in which a worker says which fled it is.
pub const VERSION_HEADER: &str = "fled-version";
/// Which fled this is.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// What a problem of a worker's request is called whose lease is another's.
pub const LEASE_LOST: &str = "lease_lost";

/// A job that a worker has taken: all that it needs to know of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Assignment {
    /// The right to tell of it.
    #[serde(flatten)]
    pub lease: Lease,
    /// Its capture.
    pub capture: String,
    /// Complete options.
    #[schema(value_type = Object)]
    pub options: Value,
    /// Claims so far, this one included.
    pub attempt: u32,
    /// Name of its preset.
    pub preset: String,
    /// The trace of the request that made it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traceparent: Option<String>,
}

impl From<Claim> for Assignment {
    fn from(claim: Claim) -> Self {
        Self {
            lease: claim.lease,
            capture: claim.job.capture_id,
            options: claim.job.options,
            attempt: claim.job.attempts,
            preset: claim.job.preset,
            traceparent: claim.job.traceparent,
        }
    }
}

/// A worker is there.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Present {
    /// What machine it is.
    pub about: About,
    /// Whether it takes no more jobs.
    #[serde(default)]
    pub draining: bool,
}

/// The jobs that a worker ran before it began anew: they wait again.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Released {
    /// Their ids.
    pub jobs: Vec<String>,
}

/// A worker wants a job.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Wanted {
    /// Which of the jobs that it runs at once this is, from 0.
    pub turn: u32,
    /// A UUID of this wish: said again, because its answer was lost, it is given the same job.
    pub wish: String,
    /// The jobs that it runs: none of them is given to it again.
    pub running: Vec<String>,
    /// Whether it has a GPU, and not a processor that plays one.
    pub has_gpu: bool,
    /// Bytes of memory.
    pub memory: u64,
}

impl Wanted {
    /// What it can do.
    pub fn machine(&self) -> Machine {
        Machine {
            has_gpu: self.has_gpu,
            memory: self.memory,
        }
    }
}

/// Under which lease something is asked.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct Under {
    /// The epoch of the lease.
    pub epoch: i64,
}

/// What a sign of life is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Pulse {
    /// Whether somebody asked to stop the job.
    pub cancel: bool,
    /// How much was told under the lease.
    pub told: i64,
}

/// One thing that a worker tells of its job.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Told {
    /// The epoch of the lease.
    pub epoch: i64,
    /// How much was told under it before: said again, because its answer was lost, it is not done
    /// again.
    pub before: i64,
    /// `{"event": ..}` of the job's process, `{"progress": ..}`, or `{"files": {"kept": [..],
    /// "gone": [..]}}`: names of files that the store has now, and of those that are no more.
    #[schema(value_type = Object)]
    pub what: What,
}

/// What is told.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// What the job's process said.
    Event(Event),
    /// How far it is.
    Progress(Progress),
    /// Files that are in the store now, and paths of some that are no more.
    Files {
        /// There.
        kept: Vec<NamedFile>,
        /// No more.
        gone: Vec<String>,
    },
}

impl From<Saying<'_>> for What {
    fn from(saying: Saying<'_>) -> Self {
        match saying {
            Saying::Event(event) => Self::Event(event.clone()),
            Saying::Progress(progress) => Self::Progress(progress.clone()),
            Saying::Files(kept, gone) => Self::Files {
                kept: kept.iter().cloned().map(NamedFile::from).collect(),
                gone: gone.to_vec(),
            },
        }
    }
}

/// How many times in a row an attempt has failed.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema)]
pub struct Failures {
    /// Without progress, the one that happens now included.
    pub failures: u32,
}

/// How an attempt ended.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Settled {
    /// The epoch of the lease.
    pub epoch: i64,
    /// `"stopped"`, `"released"`, `{"finished": {"best_round": 2}}` or `{"failed": {..}}`.
    #[schema(value_type = Object)]
    pub settlement: Settlement,
}

/// Where a job stands.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema)]
pub struct Standing {
    /// Its state.
    pub state: crate::jobs::state::JobState,
}

/// The files of a job or of its capture.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Files {
    /// Grows with every change of a job's files; a capture's never change.
    pub version: i64,
    /// All of them.
    pub files: Vec<NamedFile>,
}

/// A file in the store.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct NamedFile {
    /// In the job's or the capture's folder.
    pub path: String,
    /// BLAKE3 of its bytes, 64 lower hexadecimal digits.
    pub digest: String,
    /// How many bytes.
    pub bytes: u64,
}

impl From<Kept> for NamedFile {
    fn from(kept: Kept) -> Self {
        Self {
            path: kept.path,
            digest: kept.blob.digest,
            bytes: kept.blob.bytes,
        }
    }
}

impl From<NamedFile> for Kept {
    fn from(file: NamedFile) -> Self {
        Self {
            path: file.path,
            blob: Blob {
                digest: file.digest,
                bytes: file.bytes,
            },
        }
    }
}
