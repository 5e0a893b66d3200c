//! Database operations of a backup.

use std::collections::HashMap;
use std::path::Path;

use serde_json::json;
use sqlx::Row;

use super::{Engine, Store, engine, events};
use crate::error::Result;
use crate::store::state::JobState;

/// A job's epoch and whether it is over: as long as both are unchanged, so are its files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attempted {
    epoch: i64,
    /// Whether it succeeded, failed or was cancelled.
    pub is_over: bool,
}

impl Store {
    /// Opens a database that may be in use, without migrating its schema.
    ///
    /// # Errors
    /// When the file does not exist.
    pub async fn as_it_is(path: &Path) -> Result<Self> {
        let pool = engine::sqlite(path, false, 1).await?;
        Ok(Self::over(pool, Engine::Sqlite, None))
    }

    /// Copies a consistent snapshot of the database to a new file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub async fn copy_to(&self, path: &Path) -> Result<()> {
        sqlx::query("VACUUM INTO ?")
            .bind(path.to_string_lossy().as_ref())
            .execute(&self.pool)
            .await?;
        Ok(())
    }

    /// Returns the epoch and completion of every job.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn attempted(&self) -> Result<HashMap<String, Attempted>> {
        let rows = sqlx::query("SELECT id, state, epoch FROM jobs").fetch_all(&self.pool).await?;
        let attempted = |row: &sqlx::any::AnyRow| {
            let state: String = row.try_get("state")?;
            let job = Attempted {
                epoch: row.try_get("epoch")?,
                is_over: JobState::from_name(&state).is_some_and(JobState::is_terminal),
            };
            Ok((row.try_get("id")?, job))
        };
        rows.iter().map(attempted).collect()
    }

    /// Removes a capture with its jobs.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn forget_capture(&self, id: &str) -> Result<()> {
        let mut tx = self.write().await?;
        for forget in
            ["DELETE FROM jobs WHERE capture_id = $1", "DELETE FROM captures WHERE id = $1"]
        {
            sqlx::query(forget).bind(id).execute(&mut *tx).await?;
        }
        tx.commit().await?;
        Ok(())
    }

    /// Queues a job whose files are missing. `Ok(false)` if the job does not exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn begin_anew(&self, id: &str) -> Result<bool> {
        let mut tx = self.write().await?;
        for table in ["rounds", "stages", "warnings", "artifacts"] {
            let forget = format!("DELETE FROM {table} WHERE job_id = $1");
            sqlx::query(sqlx::AssertSqlSafe(forget)).bind(id).execute(&mut *tx).await?;
        }
        let done = sqlx::query(
            "UPDATE jobs SET state = 'queued', stage = NULL, round = 0, progress = 0,
             finished_at = NULL, best_round = NULL, error_code = NULL, error_detail = NULL,
             error_hint = NULL, overlap = NULL, detail = NULL, detail_because = NULL,
             cancel_requested = 0, failures = 0, failed_at = 0, not_before = 0, lease_owner = NULL, lease_until = 0, expires_at = NULL WHERE id = $1",
        )
        .bind(id)
        .execute(&mut *tx)
        .await?;
        if done.rows_affected() == 0 {
            return Ok(false);
        }
        let queued = json!({ "state": JobState::Queued.name() });
        events::append(&mut tx, id, "state", &queued).await?;
        tx.commit().await?;
        Ok(true)
    }
}
