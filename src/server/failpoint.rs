//! Failpoints in the life of an attempt. What happens when a worker dies at one of them is what the
//! tests of many machines ask.

use std::fmt;

/// Is told what a worker has just done; it may end the process.
pub type Watcher = fn(Failpoint);

/// What a worker has just done for a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failpoint {
    /// It has the lease, and nothing else.
    Claimed,
    /// The capture and what was made of the job before lie here.
    Fetched,
    /// The job's process runs.
    Started,
    /// The lease is extended.
    Extended,
    /// An event is told.
    Told,
    /// Progress is told.
    Advanced,
    /// Files are in the store, and have no name.
    Stored,
    /// Files have names.
    Named,
    /// It was asked to stop, and the job's process runs.
    Stopping,
    /// The job's process has ended.
    Ended,
    /// All that the attempt made is published, and the job still runs.
    Published,
    /// The job is settled.
    Settled,
}

impl Failpoint {
    /// Each of them, in the order in which an attempt comes by.
    pub const ALL: [Self; 12] = [
        Self::Claimed,
        Self::Fetched,
        Self::Started,
        Self::Extended,
        Self::Told,
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
