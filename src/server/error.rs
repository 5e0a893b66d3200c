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
    /// A program of a later version has changed the schema.
    #[error(
        "the database is of schema {version}, and this program knows {known}: a newer fled has \
         used it. Start that version, or restore a backup from before"
    )]
    NewerSchema {
        /// What the database has.
        version: i64,
        /// What the program knows.
        known: i64,
    },
    /// What `--db` names is no database.
    #[error(
        "--db is no usable database: {detail}. Give `postgres://USER:PASSWORD@HOST/DATABASE` or \
         `sqlite:FILE`"
    )]
    BadDatabase {
        /// Why.
        detail: String,
    },
    /// Machines that share a database share files, too.
    #[error(
        "a database that many machines use needs a store of files that they share: give \
         --store DIR or --store s3://BUCKET/PREFIX"
    )]
    NoFiles,
    /// The store of files refused.
    #[error("store of files: {0}")]
    Blobs(Box<fled_blobs::BlobError>),
    /// A store of files was given to an installation that has its files elsewhere.
    #[error(
        "capture {0} has no files in the store that --store names: this installation keeps them in \
         its data directory. Leave --store out, or move it to PostgreSQL: fled migrate --data \
         DIR --db postgres://.. --store PLACE"
    )]
    NotInStore(String),
    /// A store of files is another database's.
    #[error(
        "{0} belongs to another database, and this one would delete there what that one names: \
         give this one a store of its own by --store. Where it takes the other's place, stop all \
         servers and workers of the other and delete the object `mark` in the store: the next \
         start makes it anew"
    )]
    StoreOfAnother(String),
    /// An installation was not moved.
    #[error("nothing was moved: {0}")]
    NotMoved(String),
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

impl From<fled_blobs::BlobError> for ServerError {
    fn from(error: fled_blobs::BlobError) -> Self {
        Self::Blobs(Box::new(error))
    }
}

impl ServerError {
    /// Whether it is a fault of a database that is away, and may be back soon.
    pub fn passes(&self) -> bool {
        let Self::Database(error) = self else {
            return false;
        };
        match error {
            sqlx::Error::Io(_)
            | sqlx::Error::Tls(_)
            | sqlx::Error::Protocol(_)
            | sqlx::Error::PoolTimedOut
            | sqlx::Error::WorkerCrashed => true,
            // Connections, resources, whoever runs it, deadlocks, locks that were waited for.
            sqlx::Error::Database(error) => error.code().is_some_and(|code| {
                ["08", "53", "57", "40", "55P03", "25P03"]
                    .iter()
                    .any(|class| code.starts_with(class))
            }),
            _ => false,
        }
    }

    /// Whether a row was to name another that is gone, or one was to go that others name: somebody
    /// else was faster.
    pub fn is_of_a_name(&self) -> bool {
        let Self::Database(sqlx::Error::Database(error)) = self else {
            return false;
        };
        error.is_foreign_key_violation()
    }

    /// Whether a shared store of files refused or did not answer.
    pub fn is_of_the_store(&self) -> bool {
        use fled_blobs::BlobError;
        let Self::Blobs(error) = self else {
            return false;
        };
        matches!(
            **error,
            BlobError::Store { .. } | BlobError::BrokenOff { .. } | BlobError::NotReady { .. }
        )
    }

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
