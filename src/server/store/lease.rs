//! Leases: claim, heartbeat and release. Every write except the claim first checks the epoch, so a
//! worker whose lease was taken over changes nothing.

use serde_json::json;
use sqlx::Row;
use sqlx::any::AnyRow;

use super::effects::{Settlement, settle};
use super::engine::{Cells, Tx};
use super::jobs::{JobRow, from_row};
use super::{Engine, Store, events};
use crate::error::{Result, ServerError};
use crate::store::state::{JobState, Transition};

/// The right to write to a running job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub job: String,
    /// Increases with every claim.
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

/// The kind of jobs that a worker's slot runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobKind {
    /// Scenes of captures.
    Scene,
    /// Videos of results.
    Video,
}

impl JobKind {
    /// The SQL condition for rows of this kind.
    fn condition(self) -> &'static str {
        match self {
            Self::Scene => "jobs.video_of IS NULL",
            Self::Video => "jobs.video_of IS NOT NULL",
        }
    }
}

/// The resources of a machine that looks for jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Machine {
    /// Whether it has a hardware GPU.
    pub has_gpu: bool,
    /// Bytes of memory.
    pub memory: u64,
}

impl Machine {
    /// A machine that fits any job, for a deployment with a single machine.
    pub const ANY: Self = Self { has_gpu: true, memory: u64::MAX };
}

impl Store {
    /// Claims a queued scene, or one whose lease has expired and that is not in `running`, for a
    /// machine that fits any job.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn claim(
        &self,
        owner: &str,
        lease_ms: i64,
        running: &[String],
    ) -> Result<Option<Claim>> {
        self.claim_fit(JobKind::Scene, owner, lease_ms, running, Machine::ANY).await
    }

    /// Like [`Store::claim`], for a kind of job and the resources of a machine. Chooses the highest
    /// priority, then the owner with the fewest running jobs, then the oldest job.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn claim_fit(
        &self,
        kind: JobKind,
        owner: &str,
        lease_ms: i64,
        running: &[String],
        machine: Machine,
    ) -> Result<Option<Claim>> {
        let mut tx = self.begin().await?;
        let now = tx.now;
        let clock = self.lease_clock(&tx);
        // No two workers can claim the same job: SQLite has one writer, and PostgreSQL skips a row
        // that another transaction has locked.
        let waiting = next_job(self.engine, kind);
        let waiting = sqlx::query_as::<_, (String, String)>(sqlx::AssertSqlSafe(waiting))
            .bind(now)
            .bind(json!(running).to_string())
            .bind(clock)
            .bind(i64::from(machine.has_gpu))
            .bind(i64::try_from(machine.memory).unwrap_or(i64::MAX))
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
            "UPDATE jobs SET state = $1, epoch = epoch + 1, told = 0, lease_owner = $2, lease_until = $4,
                    attempts = attempts + 1, started_at = COALESCE(started_at, $3), finished_at = NULL,
                    steps_per_second = NULL, eta_seconds = NULL,
                    error_code = NULL, error_detail = NULL, error_hint = NULL
             WHERE id = $5 RETURNING *",
        )
        .bind(next.name())
        .bind(owner)
        .bind(now)
        .bind(clock.saturating_add(lease_ms))
        .bind(&id)
        .fetch_one(&mut *tx)
        .await?;
        let job = from_row(&row)?;
        let lease = Lease { job: job.id.clone(), epoch: row.try_get("epoch")? };
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

    /// Extends the lease and returns whether cancellation was requested.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] if another worker has the job.
    pub async fn heartbeat(&self, lease: &Lease, lease_ms: i64) -> Result<bool> {
        let mut tx = self.begin().await?;
        let until = self.lease_clock(&tx).saturating_add(lease_ms);
        let row = sqlx::query(
            "UPDATE jobs SET lease_until = $1 WHERE id = $2 AND epoch = $3 AND state = 'running'
             RETURNING cancel_requested",
        )
        .bind(until)
        .bind(&lease.job)
        .bind(lease.epoch)
        .fetch_optional(&mut *tx)
        .await?;
        let Some(row) = row else {
            return Err(ServerError::LeaseLost(lease.job.clone()));
        };
        tx.commit().await?;
        row.flag("cancel_requested")
    }

    /// Counts the consecutive failures without progress, including one that happens now.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn count_failure(&self, lease: &Lease) -> Result<u32> {
        let row = sqlx::query("SELECT failures, progress, failed_at FROM jobs WHERE id = $1")
            .bind(&lease.job)
            .fetch_one(&self.pool)
            .await?;
        failures_with_this(&row)
    }

    /// Queues again, or cancels if requested, all running jobs. Only for a server that has just
    /// started and holds the data directory alone: an earlier server died while they ran. The death
    /// counts as a failure of each job, since a job may be its cause; `settle_death` maps the
    /// number of failures without progress to a settlement. Returns the jobs.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn release_all(
        &self,
        settle_death: impl Fn(u32) -> Settlement,
    ) -> Result<Vec<String>> {
        let tx = self.write().await?;
        release(tx, Of::All, settle_death).await
    }

    /// Like [`Store::release_all`], for the leases of one worker that has just started and runs
    /// nothing.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn release_of(
        &self,
        worker: &str,
        settle_death: impl Fn(u32) -> Settlement,
    ) -> Result<Vec<String>> {
        let tx = self.write().await?;
        release(tx, Of::Worker(worker), settle_death).await
    }

    /// Like [`Store::release_all`], for expired leases: their workers are dead, frozen or cut off.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn release_expired(
        &self,
        settle_death: impl Fn(u32) -> Settlement,
    ) -> Result<Vec<String>> {
        let now = self.now().await?;
        let any: i64 = sqlx::query_scalar(
            "SELECT COUNT(*) FROM jobs WHERE state = 'running' AND lease_until < $1",
        )
        .bind(now)
        .fetch_one(&self.pool)
        .await?;
        if any == 0 {
            return Ok(Vec::new());
        }
        let tx = self.write().await?;
        let clock = self.lease_clock(&tx);
        release(tx, Of::Before(clock), settle_death).await
    }

    /// Begins a transaction that has checked the epoch and locked the job.
    pub(super) async fn fenced(&self, lease: &Lease) -> Result<Tx> {
        Ok(self.fenced_with_count(lease).await?.0)
    }

    /// Like [`Store::fenced`], and returns the number of reports under the lease so far.
    pub(super) async fn fenced_with_count(&self, lease: &Lease) -> Result<(Tx, i64)> {
        let mut tx = self.begin().await?;
        let held = format!(
            "SELECT told FROM jobs WHERE id = $1 AND epoch = $2 AND state = 'running'{}",
            tx.engine.locking()
        );
        let count = sqlx::query_scalar(sqlx::AssertSqlSafe(held))
            .bind(&lease.job)
            .bind(lease.epoch)
            .fetch_optional(&mut *tx)
            .await?;
        match count {
            Some(count) => Ok((tx, count)),
            None => Err(ServerError::LeaseLost(lease.job.clone())),
        }
    }
}

/// The query that selects and locks the next job: at time $1, not one of $2, leases that end before
/// $3 count as expired, on a machine with GPU $4 and memory $5.
fn next_job(engine: Engine, kind: JobKind) -> String {
    format!(
        "WITH busy AS (
                SELECT captures.owner AS owner, COUNT(*) AS jobs
                FROM jobs JOIN captures ON captures.id = jobs.capture_id
                WHERE jobs.state = 'running' AND {kind} GROUP BY captures.owner
             )
             SELECT jobs.id, jobs.state FROM jobs
             JOIN captures ON captures.id = jobs.capture_id
             LEFT JOIN busy ON busy.owner IS NOT DISTINCT FROM captures.owner
             WHERE ((jobs.state = 'queued' AND jobs.not_before <= $1)
                 OR (jobs.state = 'running' AND jobs.lease_until < $3
                     AND jobs.id NOT IN ({listed})))
             AND {kind} AND jobs.needs_gpu <= $4 AND jobs.needs_memory <= $5
             ORDER BY jobs.priority DESC, COALESCE(busy.jobs, 0), jobs.created_at, jobs.id
             LIMIT 1{skipping}",
        kind = kind.condition(),
        listed = engine.listed("$2"),
        skipping = engine.skipping(),
    )
}

/// Leases to release.
#[derive(Clone, Copy)]
enum Of<'a> {
    All,
    /// This worker's.
    Worker(&'a str),
    /// Leases that ended before this lease clock time, in milliseconds.
    Before(i64),
}

/// Settles the running jobs of `of` as after a death.
async fn release(
    mut tx: Tx,
    of: Of<'_>,
    settle_death: impl Fn(u32) -> Settlement,
) -> Result<Vec<String>> {
    let whose = match of {
        Of::All => "",
        Of::Worker(_) => "AND lease_owner LIKE $1",
        Of::Before(_) => "AND lease_until < $1",
    };
    let running = format!(
        "SELECT id, cancel_requested, failures, progress, failed_at FROM jobs
         WHERE state = 'running' {whose} ORDER BY id{}",
        tx.engine.locking()
    );
    let running = sqlx::query(sqlx::AssertSqlSafe(running));
    let running = match of {
        Of::All => running,
        Of::Worker(worker) => running.bind(format!("{worker}/%")),
        Of::Before(clock) => running.bind(clock),
    };
    let rows = running.fetch_all(&mut *tx).await?;
    let mut released = Vec::new();
    for row in rows {
        let id: String = row.try_get("id")?;
        let settlement = if row.flag("cancel_requested")? {
            Settlement::Stopped
        } else {
            settle_death(failures_with_this(&row)?)
        };
        settle(&mut tx, &id, &settlement).await?;
        // The old epoch must not write any more, in case its worker is still alive.
        sqlx::query("UPDATE jobs SET epoch = epoch + 1 WHERE id = $1")
            .bind(&id)
            .execute(&mut *tx)
            .await?;
        released.push(id);
    }
    tx.commit().await?;
    Ok(released)
}

/// Consecutive failures without progress, including one that happens now.
fn failures_with_this(row: &AnyRow) -> Result<u32> {
    let before = row.count("failures")?;
    let advanced = row.try_get::<f64, _>("progress")? > row.try_get::<f64, _>("failed_at")? + 1e-3;
    Ok(if advanced { 1 } else { before + 1 })
}
