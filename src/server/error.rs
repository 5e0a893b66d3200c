//! Errors inside the service, before they are translated for HTTP.

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// An error of the service or of a resource that it depends on.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// A file or directory could not be used.
    #[error("{path}: {source}")]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// A database operation failed.
    #[error("database: {0}")]
    Database(#[from] sqlx::Error),
    /// The schema could not be migrated.
    #[error("database schema: {0}")]
    Migration(#[from] sqlx::migrate::MigrateError),
    /// A later version has changed the schema.
    #[error(
        "the database has schema {version}, but this program knows only {known}: a newer fled has \
         used it. Start that version, or restore an earlier backup"
    )]
    NewerSchema {
        /// The version of the database's schema.
        version: i64,
        /// The latest version that this program knows.
        known: i64,
    },
    /// The value of `--db` is no usable database.
    #[error(
        "--db is not a usable database: {detail}. Use `postgres://USER:PASSWORD@HOST/DATABASE` or \
         `sqlite:FILE`"
    )]
    BadDatabase {
        /// The reason.
        detail: String,
    },
    /// Machines that share a database must share files too.
    #[error(
        "a database that several machines use needs a file store that they share: set \
         --store DIR or --store s3://BUCKET/PREFIX"
    )]
    NoFiles,
    /// The blob store failed.
    #[error("file store: {0}")]
    Blobs(Box<fled_blobs::BlobError>),
    /// A blob store was given to an installation that stores its files elsewhere.
    #[error(
        "capture {0} has no files in the store given by --store: this installation keeps them in \
         its data directory. Leave out --store, or move to PostgreSQL: fled migrate --data \
         DIR --db postgres://.. --store PLACE"
    )]
    NotInStore(String),
    /// A blob store belongs to another database.
    #[error(
        "{0} belongs to another database, whose files this one would delete: give this one its own \
         store with --store. If it replaces the other database, stop all servers and workers of \
         the other and delete the object `mark` in the store; the next start creates it again"
    )]
    StoreOfAnother(String),
    /// The migration of an installation was refused.
    #[error("nothing was moved: {0}")]
    NotMoved(String),
    /// Another server holds the data directory.
    #[error("{0} is in use by another server; stop it or choose another --data")]
    DataInUse(PathBuf),
    /// Other machines could reach a server that requires no token.
    #[error(
        "{0} can be reached from other machines, and there is no token: create one with \
         `fled token create`, listen on 127.0.0.1, or allow everyone with --open"
    )]
    Unguarded(SocketAddr),
    /// A stored value does not match the schema.
    #[error("stored {what} is damaged: {detail}")]
    Damaged {
        /// The item that was read.
        what: &'static str,
        /// The fault in the item.
        detail: String,
    },
    /// The worker no longer holds the job, so its write was discarded.
    #[error("the lease of job {0} was lost")]
    LeaseLost(String),
}

impl From<fled_blobs::BlobError> for ServerError {
    fn from(error: fled_blobs::BlobError) -> Self {
        Self::Blobs(Box::new(error))
    }
}

impl ServerError {
    /// Whether a database operation waited in vain for a connection or a lock.
    pub fn is_busy(&self) -> bool {
        // SQLITE_BUSY and SQLITE_LOCKED, the low byte of their extended codes.
        let is_lock =
            |code: &str| code.parse::<u32>().is_ok_and(|code| [5, 6].contains(&(code & 0xff)));
        match self {
            Self::Database(sqlx::Error::PoolTimedOut) => true,
            Self::Database(sqlx::Error::Database(error)) => {
                error.code().is_some_and(|code| is_lock(&code))
            }
            _ => false,
        }
    }

    /// Returns whether a database error is transient, such as a lost connection.
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
            // Connections, resources, operator intervention, serialisation failures, deadlocks,
            // lock timeouts, idle transactions.
            sqlx::Error::Database(error) => error.code().is_some_and(|code| {
                ["08", "53", "57", "40", "55P03", "25P03"]
                    .iter()
                    .any(|class| code.starts_with(class))
            }),
            _ => false,
        }
    }

    /// Returns whether a foreign key was violated: another transaction deleted the referenced row,
    /// or added a reference to a row to be deleted.
    pub fn is_of_a_name(&self) -> bool {
        let Self::Database(sqlx::Error::Database(error)) = self else {
            return false;
        };
        error.is_foreign_key_violation()
    }

    /// Returns whether a shared blob store failed or did not answer.
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

    /// Returns a constructor of [`ServerError::Io`] for `path`, for `map_err`.
    pub fn io(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}

/// The result type of this crate.
pub type Result<T, E = ServerError> = std::result::Result<T, E>;
