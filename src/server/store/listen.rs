//! Notifications of changes: PostgreSQL notifies every process that shares the database. A
//! notification is a hint; the tables hold the truth.

use sqlx::postgres::PgListener;

use super::{Engine, Store, Tx};
use crate::error::Result;

/// The channel for changes of jobs.
const CHANNEL: &str = "fled_jobs";
/// The payload for a queued job. Workers can ignore all others.
const WAITING: &str = "waiting";

/// A subscription to changes of jobs.
#[derive(Debug)]
pub struct Heard(PgListener);

/// A notification.
#[derive(Debug)]
pub enum News {
    /// A job has changed.
    Changed,
    /// A job was queued.
    Waiting,
}

impl Heard {
    /// Waits for the next notification.
    ///
    /// # Errors
    /// When the connection is lost. Notifications sent meanwhile are lost too.
    pub async fn next(&mut self) -> Result<News> {
        let told = self.0.recv().await?;
        Ok(match told.payload() {
            WAITING => News::Waiting,
            _ => News::Changed,
        })
    }
}

impl Store {
    /// Subscribes to changes of jobs; `None` if only this process makes them.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn listen(&self) -> Result<Option<Heard>> {
        let Some(url) = &self.url else {
            return Ok(None);
        };
        let mut listener = PgListener::connect(url).await?;
        listener.listen(CHANNEL).await?;
        Ok(Some(Heard(listener)))
    }
}

/// Notifies all listeners, on commit, that a job has changed or is queued.
pub(super) async fn tell(tx: &mut Tx, job: &str, waits: bool) -> Result<()> {
    if tx.engine == Engine::Postgres {
        sqlx::query("SELECT pg_notify($1, $2)")
            .bind(CHANNEL)
            .bind(if waits { WAITING } else { job })
            .execute(&mut **tx)
            .await?;
    }
    Ok(())
}
