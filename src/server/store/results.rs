//! Results of a job: rounds, stage times, warnings, digests.

use std::collections::HashMap;

use serde_json::Value;
use sqlx::{AnyPool, Row};

use super::engine::Cells;
use super::{Engine, Store};
use crate::error::{Result, ServerError};

/// The duration of one stage of one round.
#[derive(Clone, Debug, PartialEq)]
pub struct StageSeconds {
    /// Its name.
    pub stage: String,
    /// 1-based; 0 for the poses.
    pub round: u32,
    /// Wall seconds.
    pub seconds: f64,
}

/// Something the user should know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WarningRow {
    /// Stable code.
    pub code: String,
    /// One sentence.
    pub message: String,
}

impl Store {
    /// Returns the metrics of every finished round, in order.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn rounds(&self, job: &str) -> Result<Vec<Value>> {
        let rows = sqlx::query("SELECT metrics FROM rounds WHERE job_id = $1 ORDER BY round")
            .bind(job)
            .fetch_all(&self.pool)
            .await?;
        rows.iter()
            .map(|row| {
                let metrics: String = row.try_get("metrics")?;
                serde_json::from_str(&metrics).map_err(|error| ServerError::Damaged {
                    what: "round",
                    detail: error.to_string(),
                })
            })
            .collect()
    }

    /// Returns the cached digest of a result file of this size and modification time.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn digest(
        &self,
        job: &str,
        name: &str,
        bytes: i64,
        modified_ns: i64,
    ) -> Result<Option<String>> {
        Ok(sqlx::query_scalar(
            "SELECT sha256 FROM artifacts WHERE job_id = $1 AND name = $2 AND bytes = $3 AND modified_ns = $4",
        )
        .bind(job)
        .bind(name)
        .bind(bytes)
        .bind(modified_ns)
        .fetch_optional(&self.pool)
        .await?)
    }

    /// Caches the digest of a result file.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn remember_digest(
        &self,
        job: &str,
        (name, bytes, modified_ns): (&str, i64, i64),
        sha256: &str,
    ) -> Result<()> {
        sqlx::query(
            "INSERT INTO artifacts (job_id, name, bytes, modified_ns, sha256)
             VALUES ($1, $2, $3, $4, $5)
             ON CONFLICT (job_id, name) DO UPDATE SET bytes = excluded.bytes,
             modified_ns = excluded.modified_ns, sha256 = excluded.sha256",
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

/// Returns the warnings of the jobs in the JSON list `ids`, by job, oldest first.
pub(super) async fn warnings_of(
    pool: &AnyPool,
    engine: Engine,
    ids: &str,
) -> Result<HashMap<String, Vec<WarningRow>>> {
    let all = format!(
        "SELECT job_id, code, message FROM warnings WHERE job_id IN ({})
         ORDER BY at, code, message",
        engine.listed("$1")
    );
    let rows = sqlx::query(sqlx::AssertSqlSafe(all))
        .bind(ids)
        .fetch_all(pool)
        .await?;
    let mut warnings: HashMap<String, Vec<WarningRow>> = HashMap::new();
    for row in rows {
        let of_job = warnings.entry(row.try_get("job_id")?).or_default();
        of_job.push(WarningRow {
            code: row.try_get("code")?,
            message: row.try_get("message")?,
        });
    }
    Ok(warnings)
}

/// Returns the duration of every finished stage of the jobs in `ids`, by job, in no order.
pub(super) async fn stages_of(
    pool: &AnyPool,
    engine: Engine,
    ids: &str,
) -> Result<HashMap<String, Vec<StageSeconds>>> {
    let all = format!(
        "SELECT job_id, stage, round, seconds FROM stages WHERE job_id IN ({})",
        engine.listed("$1")
    );
    let rows = sqlx::query(sqlx::AssertSqlSafe(all))
        .bind(ids)
        .fetch_all(pool)
        .await?;
    let mut stages: HashMap<String, Vec<StageSeconds>> = HashMap::new();
    for row in rows {
        let of_job = stages.entry(row.try_get("job_id")?).or_default();
        of_job.push(StageSeconds {
            stage: row.try_get("stage")?,
            round: row.count("round")?,
            seconds: row.try_get("seconds")?,
        });
    }
    Ok(stages)
}
