//! Job rows: creation, reads, and user requests.

use fled_core::event::Stage;
use fled_core::metrics::{ChosenDetail, DetailLevel};
use fled_core::poses::overlap::Overlap;
use serde_json::{Value, json};
use sqlx::Row;
use sqlx::any::AnyRow;

use super::engine::Cells;
use super::notifier::Change;
use super::results::{Score, StageSeconds, WarningRow, scores_of, stages_of, warnings_of};
use super::{Store, Tx, events};
use crate::error::{Result, ServerError};
use crate::store::state::{JobState, Transition};

/// A job to be created.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// UUID v7.
    pub id: String,
    /// The user's name for it.
    pub name: String,
    /// An existing capture.
    pub capture_id: String,
    /// Name of the preset that the options started from.
    pub preset: String,
    /// Complete options.
    pub options: Value,
    /// Rounds that the options request.
    pub rounds: u32,
    /// Its machine requirements.
    pub needs: Needs,
    /// Higher values go first.
    pub priority: i64,
}

/// Why a job failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobError {
    /// Name of an error kind.
    pub code: String,
    /// A description of the error.
    pub detail: String,
    /// What the user can do about it.
    pub hint: String,
}

/// A stored job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobRow {
    /// UUID v7.
    pub id: String,
    /// The user's name for it.
    pub name: String,
    /// The user's tags.
    pub tags: Vec<String>,
    /// Its capture.
    pub capture_id: String,
    /// Name of the preset.
    pub preset: String,
    /// Complete options.
    pub options: Value,
    /// The detail that the machine which trains has chosen, if the options leave it open.
    pub detail: Option<ChosenDetail>,
    /// Its state.
    pub state: JobState,
    /// The current or last stage.
    pub stage: Option<String>,
    /// The current or last round; 0 before the first.
    pub round: u32,
    /// Rounds planned.
    pub rounds: u32,
    /// 0..=1.
    pub progress: f64,
    /// Training speed in steps per second, while training.
    pub steps_per_second: Option<f64>,
    /// Estimated seconds left.
    pub eta_seconds: Option<f64>,
    /// Why the last attempt failed.
    pub error: Option<JobError>,
    /// The delivered round of a finished job.
    pub best_round: Option<u32>,
    /// Claims so far.
    pub attempts: u32,
    /// Whether cancellation was requested.
    pub cancel_requested: bool,
    /// Milliseconds since 1970.
    pub created_at: i64,
    /// First claim.
    pub started_at: Option<i64>,
    /// End of the last attempt in a terminal state.
    pub finished_at: Option<i64>,
    /// Whether it is exempt from automatic deletion.
    pub pinned: bool,
    /// When it will be deleted.
    pub expires_at: Option<i64>,
    /// Its machine requirements.
    pub needs: Needs,
    /// Higher values go first.
    pub priority: i64,
    /// The owner of its lease: a worker and one of its slots.
    pub worker: Option<String>,
    /// The job whose result it shows, if it is a video.
    pub video_of: Option<String>,
}

/// The machine requirements of a job.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// A hardware GPU.
    pub gpu: bool,
    /// Bytes of memory.
    pub memory: u64,
}

/// A job with all its reports so far.
#[derive(Clone, Debug, PartialEq)]
pub struct JobDetails {
    /// Its row.
    pub row: JobRow,
    /// Its warnings, oldest first.
    pub warnings: Vec<WarningRow>,
    /// The duration of every finished stage, by round and then in stage order.
    pub stages: Vec<StageSeconds>,
    /// Its place in the queue, 1-based; `None` if it is not queued.
    pub queue_position: Option<u32>,
    /// When the current stage began, in milliseconds since 1970.
    pub stage_started_at: Option<i64>,
    /// The score of its delivered round.
    pub score: Option<Score>,
    /// The groups of its photographs, if matches do not connect all; never in a list of jobs.
    pub overlap: Option<Overlap>,
}

/// Which jobs to list.
#[derive(Clone, Copy, Debug, Default)]
pub struct JobFilter<'a> {
    /// Jobs in this state.
    pub state: Option<JobState>,
    /// Jobs of this capture.
    pub capture: Option<&'a str>,
    /// Jobs of this owner.
    pub owner: Option<&'a str>,
    /// The job that a request with this idempotency key created.
    pub key: Option<&'a str>,
}

/// Jobs with their queue position and current stage. The queue has the order of `Store::claim`,
/// except for the turns of owners. A stage that began before the last state change belongs to an
/// earlier attempt, so only the newest event of both kinds counts.
const DETAILED: &str = "SELECT jobs.*,
    CASE state WHEN 'queued' THEN
        (SELECT COUNT(*) FROM jobs AS ahead WHERE ahead.state = 'queued'
         AND ahead.video_of IS NULL AND (-ahead.priority, ahead.created_at, ahead.id)
             <= (-jobs.priority, jobs.created_at, jobs.id))
    END AS queue_position,
    CASE state WHEN 'running' THEN
        (SELECT CASE kind WHEN 'stage_started' THEN at END FROM events
         WHERE job_id = jobs.id AND kind IN ('stage_started', 'state')
         ORDER BY seq DESC LIMIT 1)
    END AS stage_started_at,
    CASE WHEN eta_seconds IS NOT NULL THEN
        (SELECT at FROM events WHERE job_id = jobs.id AND kind = 'progress'
         ORDER BY seq DESC LIMIT 1)
    END AS estimated_at
    FROM jobs";

impl Store {
    /// Returns the job with this id, unless it is a video.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn job(&self, id: &str) -> Result<Option<JobRow>> {
        let row = sqlx::query("SELECT * FROM jobs WHERE id = $1 AND video_of IS NULL")
            .bind(id)
            .fetch_optional(&self.pool)
            .await?;
        row.as_ref().map(from_row).transpose()
    }

    /// Returns the newest jobs older than `cursor`, newest first.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn jobs(
        &self,
        only: JobFilter<'_>,
        limit: u32,
        cursor: Option<&str>,
    ) -> Result<Vec<JobDetails>> {
        // Only the requested conditions: an optional condition keeps PostgreSQL from using its
        // indices.
        let conditions = [
            (cursor, "id < #"),
            (only.state.map(JobState::name), "state = #"),
            (only.capture, "capture_id = #"),
            (only.owner, "capture_id IN (SELECT id FROM captures WHERE owner = #)"),
            (only.key, "id IN (SELECT job_id FROM idempotency WHERE key = #)"),
        ];
        let mut page = format!("{DETAILED} WHERE video_of IS NULL");
        let mut bound = Vec::new();
        for (value, condition) in conditions.iter().filter_map(|(v, c)| Some(((*v)?, c))) {
            bound.push(value);
            page = page + " AND " + &condition.replace('#', &format!("${}", bound.len()));
        }
        let page = format!("{page} ORDER BY id DESC LIMIT {limit}");
        let page = sqlx::query(sqlx::AssertSqlSafe(page));
        let page = bound.into_iter().fold(page, sqlx::query::Query::bind);
        let rows = page.fetch_all(&self.pool).await?;
        self.detailed(&rows).await
    }

    /// Returns the job with this id and everything it has reported.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn job_details(&self, id: &str) -> Result<Option<JobDetails>> {
        let one = format!("{DETAILED} WHERE id = $1 AND video_of IS NULL");
        let row = sqlx::query(sqlx::AssertSqlSafe(one)).bind(id).fetch_optional(&self.pool).await?;
        let rows: Vec<AnyRow> = row.into_iter().collect();
        let (details, row) = (self.detailed(&rows).await?.pop(), rows.first());
        let Some((details, row)) = details.zip(row) else {
            return Ok(None);
        };
        let overlap: Option<String> = row.try_get("overlap")?;
        // Only shown: a job of which it cannot be read is still read.
        let overlap = overlap.and_then(|text| {
            let read = serde_json::from_str(&text);
            read.inspect_err(|error| tracing::warn!(job = id, %error, "unreadable overlap")).ok()
        });
        Ok(Some(JobDetails { overlap, ..details }))
    }

    /// Adds the reports of the jobs, in three statements for any number of jobs.
    async fn detailed(&self, rows: &[AnyRow]) -> Result<Vec<JobDetails>> {
        let jobs: Vec<JobRow> = rows.iter().map(from_row).collect::<Result<_>>()?;
        let ids: Vec<&str> = jobs.iter().map(|job| job.id.as_str()).collect();
        let ids = json!(ids).to_string();
        let mut warnings = warnings_of(&self.pool, self.engine, &ids).await?;
        let mut stages = stages_of(&self.pool, self.engine, &ids).await?;
        let mut scores = scores_of(&self.pool, self.engine, &ids).await?;
        let now = match jobs.iter().any(|job| job.eta_seconds.is_some()) {
            true => self.now().await?,
            false => 0,
        };
        let detailed = jobs.into_iter().zip(rows).map(|(mut job, row)| {
            let estimated_at: Option<i64> = row.try_get("estimated_at")?;
            job.eta_seconds = still_left(job.eta_seconds, estimated_at, now);
            let mut stages = stages.remove(&job.id).unwrap_or_default();
            stages.sort_by_key(|done: &StageSeconds| (done.round, place(&done.stage)));
            Ok(JobDetails {
                warnings: warnings.remove(&job.id).unwrap_or_default(),
                stages,
                queue_position: row.count_if_any("queue_position")?,
                stage_started_at: row.try_get("stage_started_at")?,
                score: scores.remove(&job.id),
                overlap: None,
                row: job,
            })
        });
        detailed.collect()
    }

    /// Counts the jobs in each state.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn jobs_by_state(&self) -> Result<Vec<(JobState, i64)>> {
        let rows = sqlx::query(
            "SELECT state, COUNT(*) AS jobs FROM jobs WHERE video_of IS NULL GROUP BY state",
        )
        .fetch_all(&self.pool)
        .await?;
        let mut counts = JobState::ALL.map(|state| (state, 0));
        for row in rows {
            let name: String = row.try_get("state")?;
            for (state, count) in &mut counts {
                if state.name() == name {
                    *count = row.try_get("jobs")?;
                }
            }
        }
        Ok(counts.to_vec())
    }

    /// Requests the cancellation of a job: a queued job stops at once, a running one through its
    /// worker. `Ok(None)` if it is over or does not exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn request_cancel(&self, id: &str) -> Result<Option<JobState>> {
        let mut tx = self.write().await?;
        let next = change(&mut tx, id, Transition::CancelRequested).await?;
        tx.commit().await?;
        Ok(next)
    }

    /// Changes a job's name and tags, if given. `Ok(false)` if it does not exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn change_job(
        &self,
        id: &str,
        name: Option<&str>,
        tags: Option<&[String]>,
    ) -> Result<bool> {
        let change = "UPDATE jobs SET name = coalesce($1, name), tags = coalesce($2, tags)
             WHERE id = $3 AND video_of IS NULL";
        let tags = tags.map(|tags| json!(tags).to_string());
        let done = sqlx::query(change).bind(name).bind(tags).bind(id);
        Ok(done.execute(&self.pool).await?.rows_affected() == 1)
    }

    /// Changes the priority of a job that is not over. `Ok(false)` if it is over or does not exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn prioritize_job(&self, id: &str, priority: i64) -> Result<bool> {
        let place = "UPDATE jobs SET priority = $1
             WHERE id = $2 AND state IN ('queued', 'running')";
        let done = sqlx::query(place).bind(priority).bind(id);
        Ok(done.execute(&self.pool).await?.rows_affected() == 1)
    }

    /// Deletes a job that is not running, with all its rows and videos. `Ok(false)` when it runs
    /// or is gone.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn delete_job(&self, id: &str) -> Result<bool> {
        let mut tx = self.begin().await?;
        let done = sqlx::query("DELETE FROM jobs WHERE id = $1 AND state <> 'running'")
            .bind(id)
            .execute(&mut *tx)
            .await?;
        tx.notify(id, Change::Job).await?;
        tx.commit().await?;
        Ok(done.rows_affected() == 1)
    }
}

/// Applies a transition to a job; `None` if the job is gone or its state does not allow it.
pub(super) async fn change(
    tx: &mut Tx,
    id: &str,
    transition: Transition,
) -> Result<Option<JobState>> {
    let Some(job) = read(tx, id).await? else {
        return Ok(None);
    };
    let Some(next) = job.state.after(transition) else {
        return Ok(None);
    };
    let finished = next.is_terminal().then_some(tx.now);
    if matches!(transition, Transition::Retried | Transition::Changed) {
        sqlx::query(
                "UPDATE jobs SET cancel_requested = 0, error_code = NULL, error_detail = NULL, error_hint = NULL,
                 overlap = NULL, detail = NULL, detail_because = NULL, failures = 0, not_before = 0,
                 expires_at = NULL WHERE id = $1",
            )
            .bind(id)
            .execute(&mut **tx)
            .await?;
    } else {
        sqlx::query("UPDATE jobs SET cancel_requested = 1 WHERE id = $1")
            .bind(id)
            .execute(&mut **tx)
            .await?;
    }
    sqlx::query("UPDATE jobs SET state = $1, finished_at = $2 WHERE id = $3")
        .bind(next.name())
        .bind(finished)
        .bind(id)
        .execute(&mut **tx)
        .await?;
    if next != job.state {
        events::append(tx, id, "state", &json!({ "state": next.name() })).await?;
    }
    Ok(Some(next))
}

pub(super) async fn insert(tx: &mut Tx, job: &NewJob) -> Result<()> {
    sqlx::query(
        "INSERT INTO jobs (id, name, capture_id, preset, options, rounds, created_at,
                           needs_gpu, needs_memory, priority)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10)",
    )
    .bind(&job.id)
    .bind(&job.name)
    .bind(&job.capture_id)
    .bind(&job.preset)
    .bind(job.options.to_string())
    .bind(i64::from(job.rounds))
    .bind(tx.now)
    .bind(i64::from(job.needs.gpu))
    .bind(i64::try_from(job.needs.memory).unwrap_or(i64::MAX))
    .bind(job.priority)
    .execute(&mut **tx)
    .await?;
    events::append(tx, &job.id, "state", &json!({ "state": JobState::Queued.name() })).await
}

pub(super) async fn read(tx: &mut Tx, id: &str) -> Result<Option<JobRow>> {
    let row = format!("SELECT * FROM jobs WHERE id = $1{}", tx.engine.locking());
    let row = sqlx::query(sqlx::AssertSqlSafe(row)).bind(id).fetch_optional(&mut **tx).await?;
    row.as_ref().map(from_row).transpose()
}

/// The time left, s, of an estimate made at a time, ms; `None` once it has passed: then the stage
/// takes longer than estimated, and nothing tells how much.
fn still_left(estimate: Option<f64>, at: Option<i64>, now: i64) -> Option<f64> {
    let left = estimate? - (now - at?) as f64 / 1e3;
    (left > 0.0).then_some(left)
}

/// The position of a stage in stage order.
fn place(name: &str) -> Option<usize> {
    Stage::ALL.iter().position(|stage| stage.name() == name)
}

fn detail(row: &AnyRow) -> Result<Option<ChosenDetail>> {
    let Some(level) = row.try_get::<Option<String>, _>("detail")? else {
        return Ok(None);
    };
    let level = DetailLevel::from_name(&level)
        .ok_or(ServerError::Damaged { what: "job detail", detail: level })?;
    let because = row.try_get::<Option<String>, _>("detail_because")?.unwrap_or_default();
    Ok(Some(ChosenDetail { level, because }))
}

pub(super) fn from_row(row: &AnyRow) -> Result<JobRow> {
    let options: String = row.try_get("options")?;
    let tags: String = row.try_get("tags")?;
    let state: String = row.try_get("state")?;
    let code: Option<String> = row.try_get("error_code")?;
    let error = match code {
        None => None,
        Some(code) => Some(JobError {
            code,
            detail: row.try_get::<Option<String>, _>("error_detail")?.unwrap_or_default(),
            hint: row.try_get::<Option<String>, _>("error_hint")?.unwrap_or_default(),
        }),
    };
    Ok(JobRow {
        id: row.try_get("id")?,
        name: row.try_get("name")?,
        tags: serde_json::from_str(&tags).map_err(|error| ServerError::Damaged {
            what: "job tags",
            detail: error.to_string(),
        })?,
        capture_id: row.try_get("capture_id")?,
        preset: row.try_get("preset")?,
        options: serde_json::from_str(&options).map_err(|error| ServerError::Damaged {
            what: "job options",
            detail: error.to_string(),
        })?,
        detail: detail(row)?,
        state: JobState::from_name(&state)
            .ok_or(ServerError::Damaged { what: "job state", detail: state })?,
        stage: row.try_get("stage")?,
        round: row.count("round")?,
        rounds: row.count("rounds")?,
        progress: row.try_get("progress")?,
        steps_per_second: row.try_get("steps_per_second")?,
        eta_seconds: row.try_get("eta_seconds")?,
        error,
        best_round: row.count_if_any("best_round")?,
        attempts: row.count("attempts")?,
        cancel_requested: row.flag("cancel_requested")?,
        created_at: row.try_get("created_at")?,
        started_at: row.try_get("started_at")?,
        finished_at: row.try_get("finished_at")?,
        pinned: row.flag("pinned")?,
        expires_at: row.try_get("expires_at")?,
        needs: Needs {
            gpu: row.flag("needs_gpu")?,
            memory: row.try_get::<i64, _>("needs_memory")?.unsigned_abs(),
        },
        priority: row.try_get("priority")?,
        worker: row.try_get("lease_owner")?,
        video_of: row.try_get("video_of")?,
    })
}
