//! What can go wrong with blobs, and what to do about it.

use std::io;
use std::path::{Path, PathBuf};

/// Why a blob could not be kept, fetched or removed.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// No store can be opened at that location.
    #[error(
        "the location of the blobs is refused: {0}; give s3://bucket/prefix, with \
         AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT in the \
         environment, or a directory"
    )]
    Location(String),
    /// The store refused or did not answer, after all retries.
    #[error(
        "{location}: cannot {doing}: {source}; check that it can be reached from here and that its \
         credentials allow this"
    )]
    Store {
        /// Where.
        location: String,
        /// What was wanted, for example `list the blobs`.
        doing: &'static str,
        /// Why.
        source: object_store::Error,
    },
    /// A request broke off again and again.
    #[error(
        "{location}: the transfer of blob {digest} broke off {attempts} times: {source}; check the \
         network between here and there, then try again"
    )]
    BrokenOff {
        /// Where.
        location: String,
        /// Which.
        digest: String,
        /// How often it was tried.
        attempts: u32,
        /// Why it did so the last time.
        source: object_store::Error,
    },
    /// The store did not answer a probe in time, or wrongly.
    #[error(
        "{location}: {detail}; check that it can be reached from here and does not lose writes"
    )]
    NotReady {
        /// Where.
        location: String,
        /// What the probe met.
        detail: String,
    },
    /// There is no such blob.
    #[error(
        "blob {digest} is not in {location}: look whether this is the store that it was put into, \
         and restore it from a backup where it is"
    )]
    Missing {
        /// Which.
        digest: String,
        /// Where.
        location: String,
    },
    /// A blob or a path is not what it was promised to be.
    #[error(
        "{what} is damaged: {detail}; it was refused, restore it from a backup or make it anew"
    )]
    Damaged {
        /// Which.
        what: String,
        /// What is wrong with it.
        detail: String,
    },
    /// Not a digest.
    #[error("{0:?} is no digest of a blob, which is 64 of the digits 0-9 and a-f; it was refused")]
    Digest(String),
    /// A file was written to while it was read; nothing was kept of it.
    #[error("{0} changed while it was read; try again when nobody writes to it")]
    Changed(PathBuf),
    /// A local file or directory could not be used.
    #[error("{path}: {source}; check that it is there and that this user may use it")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The process ends, and its threads take no more work.
    #[error("the process is stopping; try again after its start")]
    Stopping,
}

impl BlobError {
    /// A [`BlobError::Io`] about `path`, for `map_err`.
    pub(crate) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    /// Whether a local file is not there.
    pub(crate) fn is_gone(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

/// Short for results of this crate.
pub type Result<T, E = BlobError> = std::result::Result<T, E>;
