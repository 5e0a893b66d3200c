//! The event log of a job. Events are appended in the transaction of their effect.

use serde_json::Value;
use sqlx::Row;

use super::notifier::Change;
use super::{Store, Tx, outbox};
use crate::error::{Result, ServerError};
use crate::store::state::JobState;

/// One event.
#[derive(Clone, Debug, PartialEq)]
pub struct EventRow {
    /// 1, 2, 3 ... without gaps within a job.
    pub seq: i64,
    /// Its name in the stream.
    pub kind: String,
    /// Its payload.
    pub data: Value,
}

impl Store {
    /// Returns the events of a job after `seq`, in order.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn events_after(&self, job: &str, seq: i64, limit: u32) -> Result<Vec<EventRow>> {
        let rows = sqlx::query(
            "SELECT seq, kind, data FROM events WHERE job_id = $1 AND seq > $2 ORDER BY seq LIMIT $3",
        )
        .bind(job)
        .bind(seq)
        .bind(i64::from(limit))
        .fetch_all(&self.pool)
        .await?;
        rows.iter()
            .map(|row| {
                let data: String = row.try_get("data")?;
                let data = serde_json::from_str(&data).map_err(|error| ServerError::Damaged {
                    what: "event",
                    detail: error.to_string(),
                })?;
                Ok(EventRow { seq: row.try_get("seq")?, kind: row.try_get("kind")?, data })
            })
            .collect()
    }
}

/// Appends an event inside the transaction of its effect.
pub(super) async fn append(tx: &mut Tx, job: &str, kind: &str, data: &Value) -> Result<()> {
    sqlx::query(
        "INSERT INTO events (job_id, seq, at, kind, data)
         SELECT $1, COALESCE(MAX(seq), 0) + 1, $2, $3, $4 FROM events WHERE job_id = $1",
    )
    .bind(job)
    .bind(tx.now)
    .bind(kind)
    .bind(data.to_string())
    .execute(&mut **tx)
    .await?;
    outbox::tell(tx, job, kind, data).await?;
    let waits = kind == "state" && data["state"] == JobState::Queued.name();
    let change = if waits { Change::Queue } else { Change::Job };
    tx.notify(job, change).await
}
