//! Every SQL statement of the service, behind one type, for SQLite and for PostgreSQL.
//!
//! Writes that must not be lost are single transactions. SQLite runs in WAL mode with full
//! synchronisation, so once a call returns, its effect survives a power cut.

mod alone;
mod backup;
mod captures;
mod clock;
mod compact;
mod copy;
mod effects;
mod ended;
mod engine;
mod events;
mod feed;
mod files;
mod idempotency;
mod identity;
mod jobs;
mod lease;
mod migrations;
mod notifier;
mod outbox;
mod report;
mod results;
mod retention;
mod retry;
mod room;
mod sessions;
mod shares;
pub mod state;
#[cfg(test)]
pub(crate) mod tests;
mod tokens;
mod uploads;
mod videos;
mod webhooks;
mod workers;

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use sqlx::AnyPool;

use crate::error::{Result, ServerError};
use engine::Tx;
use feed::Feeds;
use notifier::Notifier;

pub use alone::Alone;
pub use backup::Attempted;
pub use captures::CaptureRow;
pub use clock::now_ms;
pub use effects::{Progress, Settlement};
pub use ended::Ended;
pub use engine::Engine;
pub use events::EventRow;
pub use feed::EventFeed;
pub use files::by_path;
pub use idempotency::{Creation, Request, UsedUp};
pub use jobs::{JobDetails, JobError, JobFilter, JobRow, Needs, NewJob};
pub use lease::{Claim, JobKind, Lease, Machine};
pub use results::{Score, StageSeconds, WarningRow};
pub use retention::Retention;
pub use retry::{Change, Retry};
pub use room::Room;
pub use shares::{NewShare, ShareRow};
pub use tokens::{NewToken, Quotas, TokenRow};
pub use uploads::UploadRow;
pub use videos::{VideoCreation, VideoRoom, VideoRow};
pub use webhooks::{DeliveryRow, Then, Tried, WebhookRow};
pub use workers::{About, WorkerRow};

/// The database. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Store {
    pool: AnyPool,
    engine: Engine,
    /// The URL of the PostgreSQL database.
    url: Option<String>,
    notifier: Arc<Notifier>,
    feeds: Arc<Feeds>,
    /// Leases are counted from here, on a clock that is never set: see [`Store::lease_clock`].
    opened: Instant,
}

impl Store {
    /// Opens or creates the database file at `path` and brings its schema up to date.
    ///
    /// # Errors
    /// When the file cannot be opened, a migration fails, or a newer version has migrated the
    /// schema.
    pub async fn open(path: &Path) -> Result<Self> {
        let pool = engine::sqlite(path, true, engine::CONNECTIONS).await?;
        engine::migrate(&pool, Engine::Sqlite).await?;
        Ok(Self::over(pool, Engine::Sqlite, None))
    }

    /// Opens the database that `--db` names: `postgres://..`, or `sqlite:FILE`.
    ///
    /// # Errors
    /// As [`Store::open`]; [`ServerError::BadDatabase`] if the URL has neither scheme.
    pub async fn at(url: &str) -> Result<Self> {
        if let Some(path) = url.strip_prefix("sqlite:") {
            return Self::open(Path::new(path)).await;
        }
        if !url.starts_with("postgres://") && !url.starts_with("postgresql://") {
            return Err(ServerError::BadDatabase {
                detail: "it does not start with `postgres://` or `sqlite:`".to_owned(),
            });
        }
        let pool = engine::postgres(url).await?;
        engine::migrate(&pool, Engine::Postgres).await?;
        Ok(Self::over(pool, Engine::Postgres, Some(url.to_owned())))
    }

    fn over(pool: AnyPool, engine: Engine, url: Option<String>) -> Self {
        Self {
            pool,
            engine,
            url,
            notifier: Arc::default(),
            feeds: Arc::default(),
            opened: Instant::now(),
        }
    }

    /// The database engine.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// Begins a transaction that reads many rows before it writes. Only one runs at a time.
    async fn write(&self) -> Result<Tx> {
        engine::begin(self, true).await
    }

    /// Begins a transaction that locks the rows it touches.
    async fn begin(&self) -> Result<Tx> {
        engine::begin(self, false).await
    }

    /// Milliseconds on the lease clock. With SQLite the clock is monotonic: it stops while the
    /// machine sleeps, ignores changes to the time of day, and restarts with each server, which
    /// first releases all leases. With PostgreSQL it is the database's clock and does not depend on
    /// the machines' clocks.
    fn lease_clock(&self, tx: &Tx) -> i64 {
        match self.engine {
            Engine::Sqlite => i64::try_from(self.opened.elapsed().as_millis()).unwrap_or(i64::MAX),
            Engine::Postgres => tx.now,
        }
    }

    /// Milliseconds since 1970 on the clock shared by all processes that use this database.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn now(&self) -> Result<i64> {
        engine::shared_now(&self.pool, self.engine).await
    }

    /// Checks that the database answers and accepts writes.
    ///
    /// # Errors
    /// When it does not.
    pub async fn check(&self) -> Result<()> {
        self.write().await?.rollback().await
    }

    /// The id of every row of `captures`, `jobs` or `uploads`.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn ids(&self, table: &'static str) -> Result<HashSet<String>> {
        let all = sqlx::AssertSqlSafe(format!("SELECT id FROM {table}"));
        let ids: Vec<String> = sqlx::query_scalar(all).fetch_all(&self.pool).await?;
        Ok(ids.into_iter().collect())
    }

    /// Waits for open statements and closes every connection.
    pub async fn close(&self) {
        self.pool.close().await;
    }
}
