//! Results of a job: rounds, stage times, warnings, digests.

use std::collections::HashMap;

use fled_core::camera::Split;
use fled_core::metrics::{Brightness, ImageKind, Record, Reference};
use serde::Deserialize;
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

/// The score of the delivered round against photographs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// What its renders are compared with.
    pub reference: Reference,
    /// The views used for the score.
    pub split: Split,
    /// Mean PSNR after a per-channel colour fit, dB.
    pub psnr_cc_db: f64,
    /// Mean SSIM; `None` without ground truth.
    pub ssim: Option<f64>,
}

impl Score {
    /// The score of a round's metrics: of held-out views and against ground truth, where available.
    /// `None` if an earlier build recorded no score that compares rounds.
    fn of(metrics: &str) -> Option<Self> {
        #[derive(Deserialize)]
        struct Judged {
            records: Vec<Record>,
            score: Option<f64>,
        }
        let judged: Judged = serde_json::from_str(metrics).ok()?;
        let has_truth = judged.records.iter().any(|one| one.reference == Reference::Gt);
        let reference = if has_truth { Reference::Gt } else { Reference::Enhanced };
        let of_split = |split| {
            judged.records.iter().find(|one| {
                let of_result =
                    one.image == ImageKind::Render && one.brightness == Brightness::Final;
                of_result && one.reference == reference && one.split == split
            })
        };
        let record = of_split(Split::HeldOut).or_else(|| of_split(Split::Train))?;
        // A render matches a shaken photograph once it is shaken in the same way. Scores up to 1
        // are SSIMs of earlier builds.
        let agreement = judged.score.filter(|score| !has_truth && *score > 1.0);
        Some(Self {
            reference,
            split: record.split,
            psnr_cc_db: agreement.unwrap_or(record.psnr_cc_db),
            ssim: has_truth.then_some(record.ssim),
        })
    }
}

/// A warning for the user.
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

    /// Caches the digest of a result file. Does nothing if the job was deleted meanwhile.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn remember_digest(
        &self,
        job: &str,
        (name, bytes, modified_ns): (&str, i64, i64),
        sha256: &str,
    ) -> Result<()> {
        let cached = sqlx::query(
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
        .await
        .map_err(ServerError::from);
        match cached {
            Err(error) if error.is_of_a_name() => Ok(()),
            cached => cached.map(drop),
        }
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
    let rows = sqlx::query(sqlx::AssertSqlSafe(all)).bind(ids).fetch_all(pool).await?;
    let mut warnings: HashMap<String, Vec<WarningRow>> = HashMap::new();
    for row in rows {
        let of_job = warnings.entry(row.try_get("job_id")?).or_default();
        of_job.push(WarningRow { code: row.try_get("code")?, message: row.try_get("message")? });
    }
    Ok(warnings)
}

/// Returns the scores of the delivered rounds of the jobs in `ids`, by job.
pub(super) async fn scores_of(
    pool: &AnyPool,
    engine: Engine,
    ids: &str,
) -> Result<HashMap<String, Score>> {
    let delivered = format!(
        "SELECT job_id, metrics FROM rounds JOIN jobs ON jobs.id = job_id
         AND jobs.best_round = rounds.round WHERE job_id IN ({})",
        engine.listed("$1")
    );
    let rows = sqlx::query(sqlx::AssertSqlSafe(delivered)).bind(ids).fetch_all(pool).await?;
    let mut scores = HashMap::new();
    for row in rows {
        let metrics: String = row.try_get("metrics")?;
        if let Some(score) = Score::of(&metrics) {
            scores.insert(row.try_get("job_id")?, score);
        }
    }
    Ok(scores)
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
    let rows = sqlx::query(sqlx::AssertSqlSafe(all)).bind(ids).fetch_all(pool).await?;
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn record(split: &str, image: &str, reference: &str, psnr: f64) -> Value {
        json!({ "split": split, "image": image, "reference": reference, "brightness": "final",
            "views": 3, "psnr_db": 1.0, "psnr_cc_db": psnr, "ssim": 0.5 })
    }

    #[test]
    fn ground_truth_and_held_out_views_score_first() {
        let score = |records: &[Value], agreement: Value| {
            let metrics = json!({ "records": records, "score": agreement, "round": 1 });
            Score::of(&metrics.to_string())
        };
        let own = record("train", "render", "enhanced", 20.0);
        let held_out = record("held_out", "render", "enhanced", 21.0);
        let truth = record("held_out", "render", "gt", 22.0);
        let dark = record("held_out", "enhanced", "gt", 9.0);
        let found = score(&[dark, own.clone(), held_out.clone(), truth], json!(30.0));
        let wanted = Score {
            reference: Reference::Gt,
            split: Split::HeldOut,
            psnr_cc_db: 22.0,
            ssim: Some(0.5),
        };
        assert_eq!(found, Some(wanted));
        let of_own = |records: &[Value], agreement| {
            let score = score(records, agreement).expect("a score");
            assert_eq!((score.reference, score.ssim), (Reference::Enhanced, None));
            (score.split, score.psnr_cc_db)
        };
        let both = [own.clone(), held_out];
        assert_eq!(of_own(&both, json!(26.5)), (Split::HeldOut, 26.5));
        assert_eq!(of_own(&both, json!(0.8)), (Split::HeldOut, 21.0));
        assert_eq!(of_own(&[own], Value::Null), (Split::Train, 20.0));
        assert_eq!(score(&[], json!(26.5)), None);
        assert_eq!(Score::of("{}"), None);
    }
}
