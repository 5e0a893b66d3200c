//! Failpoints in the life of an attempt. Tests kill a worker at each of them.

use std::fmt;

/// Called with each failpoint; it may end the process.
pub type Watcher = fn(Failpoint);

/// The last step that a worker completed for a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failpoint {
    /// It has the lease, and nothing else.
    Claimed,
    /// The capture and the earlier files of the job are here.
    Fetched,
    /// The job's process is running.
    Started,
    /// The lease has been extended.
    Extended,
    /// An event has been recorded.
    Recorded,
    /// Progress has been recorded.
    Advanced,
    /// Files are in the blob store, but not yet named.
    Stored,
    /// The files have been named.
    Named,
    /// The worker was asked to stop while the job's process runs.
    Stopping,
    /// The job's process has ended.
    Ended,
    /// All files of the attempt are published, but the job is not yet settled.
    Published,
    /// The job has been settled.
    Settled,
}

impl Failpoint {
    /// All failpoints, in the order in which an attempt passes them.
    pub const ALL: [Self; 12] = [
        Self::Claimed,
        Self::Fetched,
        Self::Started,
        Self::Extended,
        Self::Recorded,
        Self::Advanced,
        Self::Stored,
        Self::Named,
        Self::Stopping,
        Self::Ended,
        Self::Published,
        Self::Settled,
    ];
}

impl fmt::Display for Failpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", format!("{self:?}").to_lowercase())
    }
}
