//! The two databases behind the store: SQLite, a file, and PostgreSQL, shared by many machines.
//! Both run the same SQL; this module holds the differences.

use std::fmt;
use std::ops::{Deref, DerefMut};
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use sqlx::any::{AnyConnectOptions, AnyPoolOptions, AnyRow};
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::{
    Any, AnyConnection, AnyPool, Connection, Executor, Row, SqlSafeStr, SqlStr, Transaction,
};

use super::Store;
use super::clock::now_ms;
use super::migrations::{POSTGRES, SQLITE};
use super::notifier::{Change, Notifier};
use crate::error::{Result, ServerError};

/// Maximum connections to a database file.
pub(super) const CONNECTIONS: u32 = 6;

/// Maximum connections of one process to a shared database: PostgreSQL's default limit of 100
/// serves a dozen processes.
const SHARED_CONNECTIONS: u32 = 8;

/// How long to wait for another writer, or for a connection.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// Settings of each SQLite connection. Full synchronisation costs little here (measured 1,800
/// against 3,200 write transactions a second) and makes an answered request survive a power cut.
const PRAGMAS: &str = "PRAGMA busy_timeout = 10000; PRAGMA journal_mode = WAL;
    PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;";

/// Advisory lock of a PostgreSQL transaction that reads many rows before it writes: as on SQLite,
/// only one runs at a time. A worker's transactions on its own job do not take it; they lock that
/// job's row.
const WRITERS: i64 = 0x66_6c65_6401;

/// Milliseconds since 1970 on PostgreSQL's clock, which all machines share.
const ITS_CLOCK: &str =
    "SELECT CAST(FLOOR(EXTRACT(EPOCH FROM clock_timestamp()) * 1000) AS BIGINT)";

/// A database engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// A file.
    Sqlite,
    /// A server of databases.
    Postgres,
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Sqlite => "SQLite",
            Self::Postgres => "PostgreSQL",
        })
    }
}

impl Engine {
    /// Returns a query for the elements of a JSON list bound as text, for `IN (..)`.
    pub(super) fn listed(self, parameter: &str) -> String {
        match self {
            Self::Sqlite => format!("SELECT value FROM json_each({parameter})"),
            Self::Postgres => {
                format!("SELECT json_array_elements_text(CAST({parameter} AS JSON))")
            }
        }
    }

    /// The clause that locks the rows read until the transaction ends. SQLite has one writer.
    pub(super) fn locking(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            Self::Postgres => " FOR UPDATE",
        }
    }

    /// The same, but skips rows that another transaction has locked.
    pub(super) fn skipping(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            Self::Postgres => " FOR UPDATE OF jobs SKIP LOCKED",
        }
    }
}

/// A write transaction. Dropping it rolls it back.
#[derive(Debug)]
pub(super) struct Tx {
    inner: Transaction<'static, Any>,
    /// The engine of its database.
    pub(super) engine: Engine,
    /// When it began, in milliseconds since 1970 on the clock that all writers share.
    pub(super) now: i64,
    /// What its commit changes for waiting tasks.
    pub(super) change: Option<Change>,
    notifier: Arc<Notifier>,
}

impl Tx {
    pub(super) async fn commit(self) -> Result<()> {
        self.inner.commit().await?;
        if let Some(change) = self.change {
            self.notifier.notify(change);
        }
        Ok(())
    }

    pub(super) async fn rollback(self) -> Result<()> {
        Ok(self.inner.rollback().await?)
    }
}

impl Deref for Tx {
    type Target = AnyConnection;

    fn deref(&self) -> &AnyConnection {
        &self.inner
    }
}

impl DerefMut for Tx {
    fn deref_mut(&mut self) -> &mut AnyConnection {
        &mut self.inner
    }
}

/// Begins a transaction; an `exclusive` one is the only one of its kind until it ends.
pub(super) async fn begin(store: &Store, exclusive: bool) -> Result<Tx> {
    let (inner, now) = match store.engine {
        // An immediate transaction takes the write lock at once, not when it first writes: two that
        // had read by then could not both write.
        Engine::Sqlite => (store.pool.begin_with("BEGIN IMMEDIATE").await?, now_ms()),
        Engine::Postgres => {
            let mut tx = store.pool.begin().await?;
            if exclusive {
                sqlx::query("SELECT pg_advisory_xact_lock($1)")
                    .bind(WRITERS)
                    .execute(&mut *tx)
                    .await?;
            }
            let now = sqlx::query_scalar(ITS_CLOCK).fetch_one(&mut *tx).await?;
            (tx, now)
        }
    };
    Ok(Tx { inner, engine: store.engine, now, change: None, notifier: store.notifier.clone() })
}

/// Milliseconds since 1970 on the clock that all users of the database share.
pub(super) async fn shared_now(pool: &AnyPool, engine: Engine) -> Result<i64> {
    match engine {
        Engine::Sqlite => Ok(now_ms()),
        Engine::Postgres => Ok(sqlx::query_scalar(ITS_CLOCK).fetch_one(pool).await?),
    }
}

/// Connects to an SQLite file, and creates it if `create` is set.
pub(super) async fn sqlite(path: &Path, create: bool, connections: u32) -> Result<AnyPool> {
    let mode = if create { "rwc" } else { "rw" };
    let name = percent_encoding::utf8_percent_encode(
        path.to_str().ok_or_else(|| ServerError::BadDatabase {
            detail: format!("{} is not UTF-8", path.display()),
        })?,
        percent_encoding::NON_ALPHANUMERIC,
    );
    let options = options(&format!("sqlite://{name}?mode={mode}"))?;
    let pool = AnyPoolOptions::new()
        .max_connections(connections)
        .acquire_timeout(BUSY_TIMEOUT * 3)
        .after_connect(move |connection, _| {
            Box::pin(async move {
                // A database that is only read keeps its settings.
                let settings = if create { PRAGMAS } else { "PRAGMA busy_timeout = 10000" };
                connection.execute(settings).await.map(drop)
            })
        })
        .after_release(|connection, _| Box::pin(has_no_transaction(connection)));
    Ok(pool.connect_with(options).await?)
}

/// Connects to PostgreSQL.
pub(super) async fn postgres(url: &str) -> Result<AnyPool> {
    let pool = AnyPoolOptions::new()
        .max_connections(SHARED_CONNECTIONS)
        .acquire_timeout(BUSY_TIMEOUT)
        .after_connect(|connection, _| {
            Box::pin(async move {
                // A client that lost its connection must not hold its locks for long.
                let settings =
                    "SET lock_timeout = '10s'; SET idle_in_transaction_session_timeout = '20s';
                    SET tcp_user_timeout = '20s'";
                connection.execute(settings).await.map(drop)
            })
        });
    Ok(pool.connect_with(options(url)?).await?)
}

fn options(url: &str) -> Result<AnyConnectOptions> {
    sqlx::any::install_default_drivers();
    AnyConnectOptions::from_str(url)
        .map_err(|error| ServerError::BadDatabase { detail: error.to_string() })
}

/// Brings a schema up to date.
pub(super) async fn migrate(pool: &AnyPool, engine: Engine) -> Result<()> {
    let migrations: Vec<Migration> = match engine {
        Engine::Sqlite => SQLITE.iter().map(migration).collect(),
        Engine::Postgres => POSTGRES.iter().map(migration).collect(),
    };
    let known = migrations.last().map_or(0, |last| last.version);
    let outcome = Migrator::with_migrations(migrations).run(pool).await;
    outcome.map_err(|error| match error {
        sqlx::migrate::MigrateError::VersionMissing(version) if version > known => {
            ServerError::NewerSchema { version, known }
        }
        other => other.into(),
    })
}

fn migration(&(version, name, sql): &(i64, &'static str, &'static str)) -> Migration {
    let sql: SqlStr = sql.into_sql_str();
    Migration::new(version, name.into(), MigrationType::Simple, sql, false)
}

/// Returns whether a connection can be reused. On a full disk SQLite rolls back a transaction by
/// itself; sqlx, which counts transactions, then fails to roll it back and counts it forever. Such
/// a connection can begin no further transaction.
async fn has_no_transaction(connection: &mut AnyConnection) -> sqlx::Result<bool> {
    // The connection's thread rolls back a dropped transaction; it has done so once it answers the
    // ping.
    connection.ping().await?;
    Ok(!connection.is_in_transaction())
}

/// Row cells whose types the databases lack.
pub(super) trait Cells {
    /// A non-negative number.
    fn count(&self, column: &str) -> Result<u32>;
    /// A non-negative number or NULL.
    fn count_if_any(&self, column: &str) -> Result<Option<u32>>;
    /// A boolean, stored as 0 or 1.
    fn flag(&self, column: &str) -> Result<bool>;
}

impl Cells for AnyRow {
    fn count(&self, column: &str) -> Result<u32> {
        counted(self.try_get(column)?)
    }

    fn count_if_any(&self, column: &str) -> Result<Option<u32>> {
        let cell: Option<i64> = self.try_get(column)?;
        cell.map(counted).transpose()
    }

    fn flag(&self, column: &str) -> Result<bool> {
        Ok(self.try_get::<i64, _>(column)? != 0)
    }
}

/// Converts a non-negative number.
pub(super) fn counted(number: i64) -> Result<u32> {
    u32::try_from(number)
        .map_err(|error| ServerError::Damaged { what: "number", detail: error.to_string() })
}
