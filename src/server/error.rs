//! What can go wrong inside the service, before it is worded for HTTP.

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// A fault of the service or of what it stands on.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// A file or directory could not be used.
    #[error("{path}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The database refused.
    #[error("database: {0}")]
    Database(#[from] sqlx::Error),
    /// The schema could not be brought up to date.
    #[error("database schema: {0}")]
    Migration(#[from] sqlx::migrate::MigrateError),
    /// Another server holds the data directory.
    #[error("{0} is in use by another server; stop it or choose another --data")]
    DataInUse(PathBuf),
    /// Strangers could reach a server that asks nobody for a token.
    #[error(
        "{0} can be reached from other machines, and there is no token: make one by \
         `fled token create`, listen on 127.0.0.1, or let everybody in by --open"
    )]
    Unguarded(SocketAddr),
    /// A stored value is not what the schema promises.
    #[error("stored {what} is damaged: {detail}")]
    Damaged {
        /// What was read.
        what: &'static str,
        /// What is wrong with it.
        detail: String,
    },
    /// The worker no longer holds the job: what it wanted to write was dropped.
    #[error("the lease of job {0} is lost")]
    LeaseLost(String),
}

impl ServerError {
    /// An [`ServerError::Io`] about `path`, for `map_err`.
    pub fn io(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Io {
            path: path.to_owned(),
            source,
        }
    }
}

/// Short for results of this crate.
pub type Result<T, E = ServerError> = std::result::Result<T, E>;
