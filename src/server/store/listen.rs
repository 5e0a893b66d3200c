//! Being told that something changed: PostgreSQL tells everybody who shares it. What it tells is a
//! hint; what is true stands in the tables.

use sqlx::postgres::PgListener;

use super::{Engine, Store, Tx};
use crate::error::Result;

/// The channel on which changes of jobs are told.
const CHANNEL: &str = "fled_jobs";
/// What is told where a job waits. Of all else that happens no worker need hear.
const WAITING: &str = "waiting";

/// Whoever listens.
#[derive(Debug)]
pub struct Heard(PgListener);

/// What somebody has told.
#[derive(Debug)]
pub enum News {
    /// A job has changed.
    Changed,
    /// A job waits since then.
    Waiting,
}

impl Heard {
    /// Waits until somebody has told something.
    ///
    /// # Errors
    /// When the connection is lost: what was told meanwhile is, too.
    pub async fn next(&mut self) -> Result<News> {
        let told = self.0.recv().await?;
        Ok(match told.payload() {
            WAITING => News::Waiting,
            _ => News::Changed,
        })
    }
}

impl Store {
    /// Listens for changes of jobs; `None` where only this process makes them.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn listen(&self) -> Result<Option<Heard>> {
        let Some(url) = &self.url else {
            return Ok(None);
        };
        let mut listener = PgListener::connect(url).await?;
        listener.listen(CHANNEL).await?;
        Ok(Some(Heard(listener)))
    }
}

/// Tells everybody that a job has changed, or that it waits, once the transaction is true.
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
