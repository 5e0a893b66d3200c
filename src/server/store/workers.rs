//! Worker machines.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use sqlx::Row;
use sqlx::any::AnyRow;
use utoipa::ToSchema;

use super::Store;
use super::engine::Cells;
use crate::error::{Result, ServerError};

/// What a worker reports about itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct About {
    /// Name of the machine.
    pub host: String,
    /// Version of the program.
    pub version: String,
    /// Device that trains; `null` if there is none.
    pub adapter: Option<String>,
    /// Whether the adapter is a GPU.
    pub has_gpu: bool,
    /// Number of processor cores.
    pub cores: u32,
    /// Memory, bytes.
    pub memory: u64,
    /// Number of jobs that it runs at a time.
    pub jobs: u32,
}

/// The last known state of a worker.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerRow {
    /// The name it chose, which survives a restart.
    pub id: String,
    /// What it reports about itself.
    pub about: About,
    /// Whether it takes no more jobs.
    pub draining: bool,
    /// When it started, in milliseconds since 1970.
    pub started_at: i64,
    /// When it was last seen, in milliseconds since 1970.
    pub seen_at: i64,
    /// The jobs that it runs, with their training speed in steps per second.
    pub running: Vec<(String, Option<f64>)>,
}

impl Store {
    /// Records that a worker is present.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn see_worker(&self, id: &str, about: &About, draining: bool) -> Result<()> {
        let now = self.now().await?;
        let about = serde_json::to_string(about)
            .map_err(|error| ServerError::Damaged { what: "worker", detail: error.to_string() })?;
        sqlx::query(
            "INSERT INTO workers (id, about, draining, started_at, seen_at)
             VALUES ($1, $2, $3, $4, $4)
             ON CONFLICT (id) DO UPDATE SET about = excluded.about, draining = excluded.draining,
             seen_at = excluded.seen_at",
        )
        .bind(id)
        .bind(about)
        .bind(i64::from(draining))
        .bind(now)
        .execute(&self.pool)
        .await?;
        Ok(())
    }

    /// Deletes a worker that has left, and all that were last seen before `before`.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn forget_workers(&self, id: Option<&str>, before: i64) -> Result<()> {
        sqlx::query("DELETE FROM workers WHERE id = $1 OR seen_at < $2")
            .bind(id)
            .bind(before)
            .execute(&self.pool)
            .await?;
        Ok(())
    }

    /// Returns all workers, by name.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn workers(&self) -> Result<Vec<WorkerRow>> {
        let rows = sqlx::query("SELECT * FROM workers ORDER BY id").fetch_all(&self.pool).await?;
        let mut workers: Vec<WorkerRow> = rows.iter().map(worker).collect::<Result<_>>()?;
        let running = sqlx::query(
            "SELECT id, lease_owner, steps_per_second FROM jobs
             WHERE state = 'running' AND video_of IS NULL ORDER BY id",
        )
        .fetch_all(&self.pool)
        .await?;
        for row in running {
            let owner: Option<String> = row.try_get("lease_owner")?;
            let owner = owner.unwrap_or_default();
            for worker in &mut workers {
                if is_of(&owner, &worker.id) {
                    worker.running.push((row.try_get("id")?, row.try_get("steps_per_second")?));
                }
            }
        }
        Ok(workers)
    }
}

/// How long jobs wait, and how old leases are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waits {
    /// Seconds since the least recently extended lease was extended; 0 if no job runs.
    pub lease_age: f64,
    /// Seconds that the oldest queued job has waited; 0 if none waits.
    pub waiting: f64,
    /// Duration of a lease, in milliseconds.
    pub lease_ms: i64,
}

impl Store {
    /// Returns how long jobs wait and how old leases are.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn waits(&self, lease: Duration) -> Result<Waits> {
        let tx = self.begin().await?;
        let (now, clock) = (tx.now, self.lease_clock(&tx));
        tx.rollback().await?;
        let lease_ms = i64::try_from(lease.as_millis()).unwrap_or(i64::MAX);
        let (until, since): (Option<i64>, Option<i64>) = sqlx::query_as(
            "SELECT MIN(CASE state WHEN 'running' THEN lease_until END),
                    MIN(CASE state WHEN 'queued' THEN created_at END)
             FROM jobs WHERE state IN ('queued', 'running') AND video_of IS NULL",
        )
        .fetch_one(&self.pool)
        .await?;
        let seconds = |ms: i64| ms.max(0) as f64 / 1000.0;
        Ok(Waits {
            lease_age: until.map_or(0.0, |until| seconds(clock - (until - lease_ms))),
            waiting: since.map_or(0.0, |since| seconds(now - since)),
            lease_ms,
        })
    }
}

/// Returns whether a lease, which names a worker and one of its slots, belongs to this worker.
fn is_of(owner: &str, worker: &str) -> bool {
    owner.strip_prefix(worker).is_some_and(|turn| turn.starts_with('/'))
}

fn worker(row: &AnyRow) -> Result<WorkerRow> {
    let about: String = row.try_get("about")?;
    Ok(WorkerRow {
        id: row.try_get("id")?,
        about: serde_json::from_str(&about)
            .map_err(|error| ServerError::Damaged { what: "worker", detail: error.to_string() })?,
        draining: row.flag("draining")?,
        started_at: row.try_get("started_at")?,
        seen_at: row.try_get("seen_at")?,
        running: Vec::new(),
    })
}
