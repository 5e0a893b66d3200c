//! The two databases behind the store: SQLite, which is a file, and PostgreSQL, which many machines
//! share. One text of SQL serves both; what differs stands here.

use std::fmt;
use std::ops::{Deref, DerefMut};
use std::path::Path;
use std::str::FromStr;
use std::time::Duration;

use sqlx::any::{AnyConnectOptions, AnyPoolOptions, AnyRow};
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::{
    Any, AnyConnection, AnyPool, Connection, Executor, Row, SqlSafeStr, SqlStr, Transaction,
};

use super::clock::now_ms;
use super::migrations::{POSTGRES, SQLITE};
use crate::error::{Result, ServerError};

/// Connections to a database file at most.
pub(super) const CONNECTIONS: u32 = 6;

/// Connections of a process to a database that many share: what PostgreSQL allows by default, 100,
/// serves a dozen processes.
const SHARED_CONNECTIONS: u32 = 8;

/// How long a writer waits for another before it gives up, and whoever needs a connection for one.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// What a connection to SQLite is told first. Full synchronisation costs little here (measured
/// 1,800 against 3,200 write transactions a second) and makes an answered request survive a power
/// cut.
const PRAGMAS: &str = "PRAGMA busy_timeout = 10000; PRAGMA journal_mode = WAL;
    PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;";

/// Held by a transaction of PostgreSQL that looks at many rows before it writes: as on SQLite,
/// there is one at a time. Not by a worker's transactions about its own job, which hold that job's
/// row.
const WRITERS: i64 = 0x66_6c65_6401;

/// Milliseconds since 1970 by the clock of PostgreSQL, which all machines share.
const ITS_CLOCK: &str =
    "SELECT CAST(FLOOR(EXTRACT(EPOCH FROM clock_timestamp()) * 1000) AS BIGINT)";

/// Which database it is.
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
    /// The rows of a JSON list that is bound as a text, for `IN (..)`.
    pub(super) fn listed(self, parameter: &str) -> String {
        match self {
            Self::Sqlite => format!("SELECT value FROM json_each({parameter})"),
            Self::Postgres => {
                format!("SELECT json_array_elements_text(CAST({parameter} AS JSON))")
            }
        }
    }

    /// What makes a row that is read this transaction's until it ends. SQLite has one writer.
    pub(super) fn locking(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            Self::Postgres => " FOR UPDATE",
        }
    }

    /// The same, where rows that are another's are passed over.
    pub(super) fn skipping(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            Self::Postgres => " FOR UPDATE OF jobs SKIP LOCKED",
        }
    }
}

/// A transaction that writes. Dropped, it is rolled back.
#[derive(Debug)]
pub(super) struct Tx {
    inner: Transaction<'static, Any>,
    /// Of which database.
    pub(super) engine: Engine,
    /// When it began, milliseconds since 1970, by the one clock that its writers share.
    pub(super) now: i64,
}

impl Tx {
    pub(super) async fn commit(self) -> Result<()> {
        Ok(self.inner.commit().await?)
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
pub(super) async fn begin(pool: &AnyPool, engine: Engine, exclusive: bool) -> Result<Tx> {
    let (inner, now) = match engine {
        // An immediate transaction takes the write lock at once, not when it first writes: two that
        // had read by then could not both write.
        Engine::Sqlite => (pool.begin_with("BEGIN IMMEDIATE").await?, now_ms()),
        Engine::Postgres => {
            let mut tx = pool.begin().await?;
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
    Ok(Tx { inner, engine, now })
}

/// The time by the clock that all who use the database share.
pub(super) async fn shared_now(pool: &AnyPool, engine: Engine) -> Result<i64> {
    match engine {
        Engine::Sqlite => Ok(now_ms()),
        Engine::Postgres => Ok(sqlx::query_scalar(ITS_CLOCK).fetch_one(pool).await?),
    }
}

/// Connects to a file of SQLite; makes it where `create`.
pub(super) async fn sqlite(path: &Path, create: bool, connections: u32) -> Result<AnyPool> {
    let mode = if create { "rwc" } else { "rw" };
    let name = percent_encoding::utf8_percent_encode(
        path.to_str().ok_or_else(|| ServerError::BadDatabase {
            detail: format!("{} is no UTF-8", path.display()),
        })?,
        percent_encoding::NON_ALPHANUMERIC,
    );
    let options = options(&format!("sqlite://{name}?mode={mode}"))?;
    let pool = AnyPoolOptions::new()
        .max_connections(connections)
        .acquire_timeout(BUSY_TIMEOUT * 3)
        .after_connect(move |connection, _| {
            Box::pin(async move {
                // A database that is only looked at keeps its ways.
                let told = if create {
                    PRAGMAS
                } else {
                    "PRAGMA busy_timeout = 10000"
                };
                connection.execute(told).await.map(drop)
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
                // Whoever is cut off must not hold its rows for long.
                let told =
                    "SET lock_timeout = '10s'; SET idle_in_transaction_session_timeout = '20s';
                    SET tcp_user_timeout = '20s'";
                connection.execute(told).await.map(drop)
            })
        });
    Ok(pool.connect_with(options(url)?).await?)
}

fn options(url: &str) -> Result<AnyConnectOptions> {
    sqlx::any::install_default_drivers();
    AnyConnectOptions::from_str(url).map_err(|error| ServerError::BadDatabase {
        detail: error.to_string(),
    })
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

/// Whether a connection may serve again. On a full disk SQLite rolls a transaction back by itself;
/// sqlx, which counts transactions, then fails to roll it back and counts it for ever. Such a
/// connection would begin none any more.
async fn has_no_transaction(connection: &mut AnyConnection) -> sqlx::Result<bool> {
    // A dropped transaction is rolled back by the connection's thread: after the answer it is.
    connection.ping().await?;
    Ok(!connection.is_in_transaction())
}

/// Cells of a row that are other numbers than the databases know.
pub(super) trait Cells {
    /// A number that is not negative.
    fn count(&self, column: &str) -> Result<u32>;
    /// The same, or nothing.
    fn count_if_any(&self, column: &str) -> Result<Option<u32>>;
    /// 0 or 1.
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

/// A number that is not negative.
pub(super) fn counted(number: i64) -> Result<u32> {
    u32::try_from(number).map_err(|error| ServerError::Damaged {
        what: "number",
        detail: error.to_string(),
    })
}
