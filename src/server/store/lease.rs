//! What a worker does with a job: claim, report, settle. Every write but the claim begins by
//! checking the epoch, so that a worker whose lease was taken over changes nothing.

use fled_core::event::{Event, Stage};
use serde_json::{Value, json};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, Sqlite, Transaction};

use super::jobs::{JobError, JobRow, from_row, read};
use super::{Store, events, now_ms};
use crate::error::{Result, ServerError};
use crate::jobs::state::{JobState, Transition};

/// The right to write about a running job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub job: String,
    /// Grows with every claim.
    pub epoch: i64,
}

/// A claimed job.
#[derive(Clone, Debug)]
pub struct Claim {
    /// The right to write.
    pub lease: Lease,
    /// The job as claimed.
    pub job: JobRow,
}

/// How an attempt ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Settlement {
    /// The job is done.
    Finished {
        /// The delivered round.
        best_round: u32,
    },
    /// It failed for good, or is queued again after `retry_in_ms`.
    Failed {
        /// Why.
        error: JobError,
        /// Milliseconds until the next attempt.
        retry_in_ms: Option<i64>,
        /// Failures in a row without progress, this one included.
        failures: u32,
    },
    /// It was stopped on request.
    Stopped,
    /// It goes back to the queue, as the server stops.
    Released,
}

/// Progress of a running job, as shown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// Stage, round, units done and in all.
    pub stage: Option<(Stage, u32, u64, u64)>,
    /// Training speed.
    pub steps_per_second: Option<f64>,
    /// 0..=1 of the whole job, when known anew.
    pub progress: Option<f64>,
    /// Seconds left, when known anew.
    pub eta_seconds: Option<f64>,
}

impl Store {
    /// Takes the oldest job that waits or whose lease has run out, but none of `running`.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn claim(
        &self,
        owner: &str,
        lease_ms: i64,
        running: &[String],
    ) -> Result<Option<Claim>> {
        let now = now_ms();
        let mut tx = self.pool.begin_with("BEGIN IMMEDIATE").await?;
        // The transaction holds the write lock: no two workers can take the same job.
        let waiting = sqlx::query_as::<_, (String, String)>(
            "SELECT id, state FROM jobs
             WHERE (state = 'queued' AND not_before <= ?1)
                OR (state = 'running' AND lease_until < ?3
                    AND id NOT IN (SELECT value FROM json_each(?2)))
             ORDER BY created_at, id LIMIT 1",
        )
        .bind(now)
        .bind(json!(running).to_string())
        .bind(self.lease_clock())
        .fetch_optional(&mut *tx)
        .await?;
        let Some((id, state)) = waiting else {
            return Ok(None);
        };
        let next = JobState::from_name(&state)
            .and_then(|state| state.after(Transition::Claimed))
            .ok_or_else(|| ServerError::Damaged {
                what: "job state",
                detail: format!("job {id} is {state} and cannot be claimed"),
            })?;
        let row = sqlx::query(
            "UPDATE jobs SET state = ?1, epoch = epoch + 1, lease_owner = ?2, lease_until = ?4,
                    attempts = attempts + 1, started_at = COALESCE(started_at, ?3), finished_at = NULL,
                    steps_per_second = NULL, eta_seconds = NULL,
                    error_code = NULL, error_detail = NULL, error_hint = NULL
             WHERE id = ?5 RETURNING *",
        )
        .bind(next.name())
        .bind(owner)
        .bind(now)
        .bind(self.lease_clock().saturating_add(lease_ms))
        .bind(&id)
        .fetch_one(&mut *tx)
        .await?;
        let job = from_row(&row)?;
        let lease = Lease {
            job: job.id.clone(),
            epoch: row.try_get("epoch")?,
        };
        events::append(
            &mut tx,
            &job.id,
            "state",
            &json!({ "state": next.name(), "attempt": job.attempts }),
        )
        .await?;
        tx.commit().await?;
        Ok(Some(Claim { lease, job }))
    }

    /// Extends the lease and says whether somebody asked to stop the job.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has it.
    pub async fn heartbeat(&self, lease: &Lease, lease_ms: i64) -> Result<bool> {
        let row = sqlx::query(
            "UPDATE jobs SET lease_until = ? WHERE id = ? AND epoch = ? AND state = 'running' RETURNING cancel_requested",
        )
        .bind(self.lease_clock().saturating_add(lease_ms))
        .bind(&lease.job)
        .bind(lease.epoch)
        .fetch_optional(&self.pool)
        .await?;
        match row {
            Some(row) => Ok(row.try_get("cancel_requested")?),
            None => Err(ServerError::LeaseLost(lease.job.clone())),
        }
    }

    /// Stores what an event of the job's process says.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn record(&self, lease: &Lease, event: &Event) -> Result<()> {
        let mut tx = self.fenced(lease).await?;
        apply(&mut tx, &lease.job, event).await?;
        let data = serde_json::to_value(event).map_err(|error| ServerError::Damaged {
            what: "event",
            detail: error.to_string(),
        })?;
        let kind = data["event"].as_str().unwrap_or("event").to_owned();
        events::append(&mut tx, &lease.job, &kind, &data).await?;
        tx.commit().await?;
        Ok(())
    }

    /// Stores progress and tells of it.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn advance(&self, lease: &Lease, progress: &Progress) -> Result<()> {
        let mut tx = self.fenced(lease).await?;
        let stage = progress.stage;
        let row = sqlx::query(
            "UPDATE jobs SET stage = COALESCE(?, stage), round = COALESCE(?, round), steps_per_second = ?,
                    progress = MAX(progress, COALESCE(?, progress)), eta_seconds = COALESCE(?, eta_seconds)
             WHERE id = ? RETURNING stage, round, progress, eta_seconds",
        )
        .bind(stage.map(|(stage, ..)| stage.name()))
        .bind(stage.map(|(_, round, ..)| round))
        .bind(progress.steps_per_second)
        .bind(progress.progress)
        .bind(progress.eta_seconds)
        .bind(&lease.job)
        .fetch_one(&mut *tx)
        .await?;
        let mut data = json!({
            "stage": row.try_get::<Option<String>, _>("stage")?,
            "round": row.try_get::<u32, _>("round")?,
            "progress": row.try_get::<f64, _>("progress")?,
        });
        if let Some((_, _, done, total)) = stage {
            data["done"] = done.into();
            data["total"] = total.into();
        }
        if let Some(eta) = row.try_get::<Option<f64>, _>("eta_seconds")? {
            data["eta_seconds"] = eta.into();
        }
        if let Some(rate) = progress.steps_per_second {
            data["steps_per_second"] = rate.into();
        }
        events::append(&mut tx, &lease.job, "progress", &data).await?;
        tx.commit().await?;
        Ok(())
    }

    /// Ends an attempt.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn settle(&self, lease: &Lease, settlement: &Settlement) -> Result<JobState> {
        let mut tx = self.fenced(lease).await?;
        settle(&mut tx, &lease.job, settlement).await?;
        let state = read(&mut tx, &lease.job)
            .await?
            .map_or(JobState::Queued, |job| job.state);
        tx.commit().await?;
        Ok(state)
    }

    /// Failures in a row without progress, counting one that happens now.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn count_failure(&self, lease: &Lease) -> Result<u32> {
        let row = sqlx::query("SELECT failures, progress, failed_at FROM jobs WHERE id = ?")
            .bind(&lease.job)
            .fetch_one(&self.pool)
            .await?;
        failures_with_this(&row)
    }

    /// Queues again (or, where that was asked, cancels) what runs under any lease. Only for a
    /// server that has just started and holds the data directory alone: an earlier one died while
    /// these ran. That counts as a failure of theirs, and they may be why; `settle_death` says
    /// what follows from so many without progress. Returns the jobs.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn release_all(
        &self,
        settle_death: impl Fn(u32) -> Settlement,
    ) -> Result<Vec<String>> {
        let mut tx = self.pool.begin_with("BEGIN IMMEDIATE").await?;
        let rows = sqlx::query(
            "SELECT id, cancel_requested, failures, progress, failed_at FROM jobs
             WHERE state = 'running'",
        )
        .fetch_all(&mut *tx)
        .await?;
        let mut released = Vec::new();
        for row in rows {
            let id: String = row.try_get("id")?;
            let settlement = if row.try_get("cancel_requested")? {
                Settlement::Stopped
            } else {
                settle_death(failures_with_this(&row)?)
            };
            settle(&mut tx, &id, &settlement).await?;
            // The old epoch must not write any more, should its worker still breathe.
            sqlx::query("UPDATE jobs SET epoch = epoch + 1 WHERE id = ?")
                .bind(&id)
                .execute(&mut *tx)
                .await?;
            released.push(id);
        }
        tx.commit().await?;
        Ok(released)
    }

    /// A transaction that has checked the epoch, and holds the write lock since.
    async fn fenced(&self, lease: &Lease) -> Result<Transaction<'static, Sqlite>> {
        let mut tx = self.pool.begin().await?;
        let done = sqlx::query(
            "UPDATE jobs SET epoch = epoch WHERE id = ? AND epoch = ? AND state = 'running'",
        )
        .bind(&lease.job)
        .bind(lease.epoch)
        .execute(&mut *tx)
        .await?;
        if done.rows_affected() == 1 {
            Ok(tx)
        } else {
            Err(ServerError::LeaseLost(lease.job.clone()))
        }
    }
}

/// Failures in a row without progress, counting one that happens now.
fn failures_with_this(row: &SqliteRow) -> Result<u32> {
    let before: u32 = row.try_get("failures")?;
    let advanced = row.try_get::<f64, _>("progress")? > row.try_get::<f64, _>("failed_at")? + 1e-3;
    Ok(if advanced { 1 } else { before + 1 })
}

/// The effect of an event on the job's row and its results.
async fn apply(tx: &mut Transaction<'static, Sqlite>, job: &str, event: &Event) -> Result<()> {
    let query = match event {
        Event::Planned { rounds, .. } => sqlx::query("UPDATE jobs SET rounds = ? WHERE id = ?")
            .bind(*rounds)
            .bind(job),
        Event::StageStarted { stage, round } => sqlx::query(
            "UPDATE jobs SET stage = ?, round = ?, steps_per_second = NULL WHERE id = ?",
        )
        .bind(stage.name())
        .bind(*round)
        .bind(job),
        Event::StageFinished {
            stage,
            round,
            seconds,
            skipped,
        } => sqlx::query(if *skipped {
            // It was found on disk; the attempt that made it has told its time.
            "INSERT OR IGNORE INTO stages (job_id, stage, round, seconds) VALUES (?, ?, ?, ?)"
        } else {
            "INSERT OR REPLACE INTO stages (job_id, stage, round, seconds) VALUES (?, ?, ?, ?)"
        })
        .bind(job)
        .bind(stage.name())
        .bind(*round)
        .bind(*seconds),
        Event::RoundFinished { metrics } => {
            let json = serde_json::to_string(metrics).map_err(|error| ServerError::Damaged {
                what: "round",
                detail: error.to_string(),
            })?;
            sqlx::query("INSERT OR REPLACE INTO rounds (job_id, round, metrics) VALUES (?, ?, ?)")
                .bind(job)
                .bind(metrics.round)
                .bind(json)
        }
        Event::Warning { code, message } => sqlx::query(
            "INSERT OR IGNORE INTO warnings (job_id, code, message, at) VALUES (?, ?, ?, ?)",
        )
        .bind(job)
        .bind(code.clone())
        .bind(message.clone())
        .bind(now_ms()),
        _ => return Ok(()),
    };
    query.execute(&mut **tx).await?;
    Ok(())
}

async fn settle(
    tx: &mut Transaction<'static, Sqlite>,
    job: &str,
    settlement: &Settlement,
) -> Result<()> {
    let transition = match settlement {
        Settlement::Finished { .. } => Transition::Finished,
        Settlement::Failed { retry_in_ms, .. } => Transition::Failed {
            retry: retry_in_ms.is_some(),
        },
        Settlement::Stopped => Transition::Stopped,
        Settlement::Released => Transition::Released,
    };
    let next = JobState::Running
        .after(transition)
        .ok_or_else(|| ServerError::Damaged {
            what: "job state",
            detail: format!("{transition:?}"),
        })?;
    let finished = next.is_terminal().then(now_ms);
    sqlx::query(
        "UPDATE jobs SET state = ?, finished_at = ?, lease_owner = NULL, lease_until = 0,
                steps_per_second = NULL, eta_seconds = NULL WHERE id = ?",
    )
    .bind(next.name())
    .bind(finished)
    .bind(job)
    .execute(&mut **tx)
    .await?;
    let mut data = json!({ "state": next.name() });
    match settlement {
        Settlement::Finished { best_round } => {
            sqlx::query(
                "UPDATE jobs SET progress = 1, best_round = ?, stage = NULL, failures = 0 WHERE id = ?",
            )
            .bind(*best_round)
            .bind(job)
            .execute(&mut **tx)
            .await?;
            data["best_round"] = (*best_round).into();
        }
        Settlement::Failed {
            error,
            retry_in_ms,
            failures,
        } => {
            store_failure(tx, job, error, *retry_in_ms, *failures).await?;
            data["error"] = error_json(error);
            data["retry_in_ms"] = (*retry_in_ms).into();
        }
        Settlement::Stopped | Settlement::Released => {}
    }
    events::append(tx, job, "state", &data).await
}

async fn store_failure(
    tx: &mut Transaction<'static, Sqlite>,
    job: &str,
    error: &JobError,
    retry_in_ms: Option<i64>,
    failures: u32,
) -> Result<()> {
    sqlx::query(
        "UPDATE jobs SET error_code = ?, error_detail = ?, error_hint = ?, failures = ?, failed_at = progress,
                not_before = ? WHERE id = ?",
    )
    .bind(&error.code)
    .bind(&error.detail)
    .bind(&error.hint)
    .bind(failures)
    .bind(retry_in_ms.map_or(0, |wait| now_ms() + wait))
    .bind(job)
    .execute(&mut **tx)
    .await?;
    Ok(())
}

fn error_json(error: &JobError) -> Value {
    json!({ "code": error.code, "detail": error.detail, "hint": error.hint })
}
