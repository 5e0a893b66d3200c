//! What a job has shown: rounds, stage times, warnings, digests.

use serde::Deserialize;
use serde_json::Value;
use sqlx::Row;

use super::Store;
use crate::error::{Result, ServerError};

/// The time of one stage of one round.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct StageSeconds {
    /// Its name.
    pub stage: String,
    /// 1-based; 0 for the poses.
    pub round: u32,
    /// Wall seconds.
    pub seconds: f64,
}

/// Something the user should know.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct WarningRow {
    /// Stable code.
    pub code: String,
    /// One sentence.
    pub message: String,
}

impl Store {
    /// The metrics of every finished round, in order.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn rounds(&self, job: &str) -> Result<Vec<Value>> {
        let rows = sqlx::query("SELECT metrics FROM rounds WHERE job_id = ? ORDER BY round")
            .bind(job)
            .fetch_all(&self.pool)
            .await?;
        rows.iter()
            .map(|row| {
                serde_json::from_str(row.try_get("metrics")?).map_err(|error| {
                    ServerError::Damaged {
                        what: "round",
                        detail: error.to_string(),
                    }
                })
            })
            .collect()
    }

    /// The remembered digest of a result file of this size and modification time.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn digest(
        &self,
        job: &str,
        name: &str,
        bytes: i64,
        modified_ns: i64,
    ) -> Result<Option<String>> {
        Ok(sqlx::query_scalar(
            "SELECT sha256 FROM artifacts WHERE job_id = ? AND name = ? AND bytes = ? AND modified_ns = ?",
        )
        .bind(job)
        .bind(name)
        .bind(bytes)
        .bind(modified_ns)
        .fetch_optional(&self.pool)
        .await?)
    }

    /// Remembers the digest of a result file.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn remember_digest(
        &self,
        job: &str,
        (name, bytes, modified_ns): (&str, i64, i64),
        sha256: &str,
    ) -> Result<()> {
        sqlx::query(
            "INSERT OR REPLACE INTO artifacts (job_id, name, bytes, modified_ns, sha256) VALUES (?, ?, ?, ?, ?)",
        )
        .bind(job)
        .bind(name)
        .bind(bytes)
        .bind(modified_ns)
        .bind(sha256)
        .execute(&self.pool)
        .await?;
        Ok(())
    }
}
