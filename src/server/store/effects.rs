//! Effects of events on a job's rows, inside the transaction that records the event.

use fled_core::event::{Event, Stage};
use serde::Serialize;
use serde_json::{Value, json};
use sqlx::Row;

use super::engine::{Cells, Tx};
use super::events;
use super::jobs::JobError;
use crate::error::{Result, ServerError};
use crate::store::state::{JobState, Transition};

/// The stored value for an unknown time, speed or fraction.
const UNKNOWN: f64 = -1.0;

/// How an attempt ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Settlement {
    /// The job succeeded.
    Finished {
        /// The delivered round.
        best_round: u32,
    },
    /// The video was rendered.
    Filmed {
        /// Its size in bytes.
        bytes: u64,
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
    /// It was cancelled on request.
    Stopped,
    /// It goes back to the queue because the server stops.
    Released,
}

/// Displayed progress of a running job.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// Stage, round, units done and units in total.
    pub stage: Option<(Stage, u32, u64, u64)>,
    /// Training speed in steps per second.
    pub steps_per_second: Option<f64>,
    /// Fraction of the whole job, 0..=1, if updated.
    pub progress: Option<f64>,
    /// Seconds left, updated with the fraction; `None` if unknown.
    pub eta_seconds: Option<f64>,
}

/// Applies an event to the job's row and results.
pub(super) async fn apply(tx: &mut Tx, job: &str, event: &Event) -> Result<()> {
    let query = match event {
        Event::Planned { rounds, .. } => sqlx::query("UPDATE jobs SET rounds = $1 WHERE id = $2")
            .bind(i64::from(*rounds))
            .bind(job),
        Event::DetailChosen { detail } => {
            sqlx::query("UPDATE jobs SET detail = $1, detail_because = $2 WHERE id = $3")
                .bind(detail.level.name())
                .bind(detail.because.clone())
                .bind(job)
        }
        Event::StageStarted { stage, round } => sqlx::query(
            "UPDATE jobs SET stage = $1, round = $2, steps_per_second = NULL WHERE id = $3",
        )
        .bind(stage.name())
        .bind(i64::from(*round))
        .bind(job),
        Event::StageFinished { stage, round, seconds, skipped } => sqlx::query(if *skipped {
            // It was found on disk; an earlier attempt has recorded its time.
            "INSERT INTO stages (job_id, stage, round, seconds) VALUES ($1, $2, $3, $4)
             ON CONFLICT DO NOTHING"
        } else {
            "INSERT INTO stages (job_id, stage, round, seconds) VALUES ($1, $2, $3, $4)
             ON CONFLICT (job_id, stage, round) DO UPDATE SET seconds = excluded.seconds"
        })
        .bind(job)
        .bind(stage.name())
        .bind(i64::from(*round))
        .bind(*seconds),
        Event::RoundFinished { metrics } => {
            let json = json_of("round", metrics)?;
            sqlx::query(
                "INSERT INTO rounds (job_id, round, metrics) VALUES ($1, $2, $3)
                 ON CONFLICT (job_id, round) DO UPDATE SET metrics = excluded.metrics",
            )
            .bind(job)
            .bind(i64::from(metrics.round))
            .bind(json)
        }
        Event::Warning { code, message } => sqlx::query(
            "INSERT INTO warnings (job_id, code, message, at) VALUES ($1, $2, $3, $4)
             ON CONFLICT DO NOTHING",
        )
        .bind(job)
        .bind(code.clone())
        .bind(message.clone())
        .bind(tx.now),
        Event::OverlapFound(overlap) => {
            let json = json_of("overlap", overlap)?;
            sqlx::query("UPDATE jobs SET overlap = $1 WHERE id = $2").bind(json).bind(job)
        }
        _ => return Ok(()),
    };
    query.execute(&mut **tx).await?;
    Ok(())
}

/// The stored form of a report.
fn json_of(what: &'static str, report: &impl Serialize) -> Result<String> {
    let damaged = |error: serde_json::Error| {
        let detail = error.to_string();
        ServerError::Damaged { what, detail }
    };
    serde_json::to_string(report).map_err(damaged)
}

/// Ends an attempt.
pub(super) async fn settle(tx: &mut Tx, job: &str, settlement: &Settlement) -> Result<()> {
    let transition = match settlement {
        Settlement::Finished { .. } | Settlement::Filmed { .. } => Transition::Finished,
        Settlement::Failed { retry_in_ms, .. } => {
            Transition::Failed { retry: retry_in_ms.is_some() }
        }
        Settlement::Stopped => Transition::Stopped,
        Settlement::Released => Transition::Released,
    };
    let next = JobState::Running.after(transition).ok_or_else(|| ServerError::Damaged {
        what: "job state",
        detail: format!("{transition:?}"),
    })?;
    let finished = next.is_terminal().then_some(tx.now);
    sqlx::query(
        "UPDATE jobs SET state = $1, finished_at = $2, lease_owner = NULL, lease_until = 0,
                steps_per_second = NULL, eta_seconds = NULL WHERE id = $3",
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
                "UPDATE jobs SET progress = 1, best_round = $1, stage = NULL, failures = 0 WHERE id = $2",
            )
            .bind(i64::from(*best_round))
            .bind(job)
            .execute(&mut **tx)
            .await?;
            data["best_round"] = (*best_round).into();
        }
        Settlement::Filmed { bytes } => {
            sqlx::query("UPDATE jobs SET progress = 1, failures = 0, bytes = $1 WHERE id = $2")
                .bind(i64::try_from(*bytes).unwrap_or(i64::MAX))
                .bind(job)
                .execute(&mut **tx)
                .await?;
        }
        Settlement::Failed { error, retry_in_ms, failures } => {
            store_failure(tx, job, error, *retry_in_ms, *failures).await?;
            data["error"] = error_json(error);
            data["retry_in_ms"] = (*retry_in_ms).into();
        }
        Settlement::Stopped | Settlement::Released => {}
    }
    events::append(tx, job, "state", &data).await
}

async fn store_failure(
    tx: &mut Tx,
    job: &str,
    error: &JobError,
    retry_in_ms: Option<i64>,
    failures: u32,
) -> Result<()> {
    sqlx::query(
        "UPDATE jobs SET error_code = $1, error_detail = $2, error_hint = $3, failures = $4, failed_at = progress,
                not_before = $5 WHERE id = $6",
    )
    .bind(&error.code)
    .bind(&error.detail)
    .bind(&error.hint)
    .bind(i64::from(failures))
    .bind(retry_in_ms.map_or(0, |wait| tx.now + wait))
    .bind(job)
    .execute(&mut **tx)
    .await?;
    Ok(())
}

fn error_json(error: &JobError) -> Value {
    json!({ "code": error.code, "detail": error.detail, "hint": error.hint })
}

/// Applies progress to the job's row and appends its event.
pub(super) async fn advance(tx: &mut Tx, job: &str, progress: &Progress) -> Result<()> {
    let stage = progress.stage;
    let row = sqlx::query(
        "UPDATE jobs SET stage = COALESCE($1, stage), round = COALESCE($2, round),
                steps_per_second = CASE WHEN $3 >= 0 THEN $3 END,
                progress = CASE WHEN $4 > progress THEN $4 ELSE progress END,
                eta_seconds = CASE WHEN $5 >= 0 THEN $5 WHEN $4 < 0 THEN eta_seconds END
         WHERE id = $6 RETURNING stage, round, progress, eta_seconds",
    )
    .bind(stage.map(|(stage, ..)| stage.name()))
    .bind(stage.map(|(_, round, ..)| i64::from(round)))
    // Not NULL: sqlx 0.9 declares a missing f64 to PostgreSQL as an f32, and then the next value
    // too.
    .bind(progress.steps_per_second.unwrap_or(UNKNOWN))
    .bind(progress.progress.unwrap_or(UNKNOWN))
    .bind(progress.eta_seconds.unwrap_or(UNKNOWN))
    .bind(job)
    .fetch_one(&mut **tx)
    .await?;
    let mut data = json!({
        "stage": row.try_get::<Option<String>, _>("stage")?,
        "round": row.count("round")?,
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
    events::append(tx, job, "progress", &data).await
}
