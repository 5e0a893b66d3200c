//! Errors of the blob store, with advice.

use std::io;
use std::path::{Path, PathBuf};

/// Why a blob could not be stored, fetched or removed.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// No store can be opened at this location.
    #[error(
        "the location of the blobs is refused: {0}; give s3://bucket/prefix, with \
         AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT in the \
         environment, or a directory"
    )]
    Location(String),
    /// The store failed or did not answer, after all retries.
    #[error(
        "{location}: cannot {doing}: {source}; check that it can be reached from here and that its \
         credentials allow this"
    )]
    Store {
        /// The location of the store.
        location: String,
        /// The attempted operation, for example `list the blobs`.
        doing: &'static str,
        /// The cause.
        source: object_store::Error,
    },
    /// A transfer broke off repeatedly.
    #[error(
        "{location}: the transfer of blob {digest} broke off {attempts} times: {source}; check the \
         network between here and there, then try again"
    )]
    BrokenOff {
        /// The location of the store.
        location: String,
        /// The digest of the blob.
        digest: String,
        /// Number of attempts.
        attempts: u32,
        /// The cause of the last failure.
        source: object_store::Error,
    },
    /// The store did not answer a probe in time, or answered wrongly.
    #[error(
        "{location}: {detail}; check that it can be reached from here and does not lose writes"
    )]
    NotReady {
        /// The location of the store.
        location: String,
        /// The error of the probe.
        detail: String,
    },
    /// The blob does not exist.
    #[error(
        "blob {digest} is not in {location}: look whether this is the store that it was put into, \
         and restore it from a backup where it is"
    )]
    Missing {
        /// The digest of the blob.
        digest: String,
        /// The location of the store.
        location: String,
    },
    /// A blob or a path does not match its description.
    #[error(
        "{what} is damaged: {detail}; it was refused, restore it from a backup or make it anew"
    )]
    Damaged {
        /// The blob or path.
        what: String,
        /// What is wrong with it.
        detail: String,
    },
    /// Not a digest.
    #[error("{0:?} is no digest of a blob, which is 64 of the digits 0-9 and a-f; it was refused")]
    Digest(String),
    /// A file was written to while it was read; nothing was stored.
    #[error("{0} changed while it was read; try again when nothing writes to it")]
    Changed(PathBuf),
    /// A local file or directory could not be used.
    #[error("{path}: {source}; check that it is there and that this user may use it")]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// The process is ending and accepts no more blocking work.
    #[error("the process is stopping; try again after its start")]
    Stopping,
}

impl BlobError {
    /// Returns a constructor of [`BlobError::Io`] for `path`, for `map_err`.
    pub(crate) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    /// Returns whether a local file does not exist.
    pub(crate) fn is_gone(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

/// The result type of this crate.
pub type Result<T, E = BlobError> = std::result::Result<T, E>;
