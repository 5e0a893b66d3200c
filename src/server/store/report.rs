//! Reports of a worker on its job. Each is a transaction that first checks the epoch, and is
//! repeated if the database was unavailable and its answer is lost. The job counts the reports
//! under a lease, so that a report whose answer was lost is not applied twice.

use std::time::{Duration, Instant};

use fled_blobs::Kept;
use fled_core::event::Event;
use sqlx::Row;

use super::effects::{Progress, Settlement, advance, apply, settle};
use super::jobs::read;
use super::lease::Lease;
use super::{Engine, Store, Tx, events, files};
use crate::error::{Result, ServerError};
use crate::store::state::JobState;

/// How long to retry while the database is unavailable: no longer than a worker may run without
/// contact.
const PATIENCE: Duration = Duration::from_secs(20);

/// Pause between two attempts.
const PAUSE: Duration = Duration::from_millis(500);

/// A report.
#[derive(Clone, Copy, Debug)]
pub(super) enum Report<'a> {
    /// An event of the job's process.
    Event(&'a Event),
    /// The progress of the job.
    Progress(&'a Progress),
    /// Files now in the blob store, and paths of files that are gone.
    Files(&'a [Kept], &'a [String]),
}

impl Store {
    /// Records an event of the job's process.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn record(&self, lease: &Lease, event: &Event) -> Result<()> {
        self.report(lease, Report::Event(event)).await
    }

    /// Records progress and its event.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn advance(&self, lease: &Lease, progress: &Progress) -> Result<()> {
        self.report(lease, Report::Progress(progress)).await
    }

    /// Ends an attempt.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn settle(&self, lease: &Lease, settlement: &Settlement) -> Result<JobState> {
        let begun = Instant::now();
        loop {
            let error = match self.settle_once(lease, settlement).await {
                // The answer of a cut connection may be lost although its transaction was
                // committed.
                Err(ServerError::LeaseLost(job)) => return self.settled_by_us(lease, job).await,
                Err(error) if self.may_pass(&error, begun) => error,
                settled => return settled,
            };
            tracing::warn!(%error, job = lease.job, "settling an attempt again");
            tokio::time::sleep(PAUSE).await;
        }
    }

    async fn settle_once(&self, lease: &Lease, settlement: &Settlement) -> Result<JobState> {
        let mut tx = self.fenced(lease).await?;
        settle(&mut tx, &lease.job, settlement).await?;
        let state = read(&mut tx, &lease.job).await?.map_or(JobState::Queued, |job| job.state);
        tx.commit().await?;
        Ok(state)
    }

    /// The state of a job that ran under this lease, if no other worker has claimed it since.
    async fn settled_by_us(&self, lease: &Lease, job: String) -> Result<JobState> {
        let row = sqlx::query("SELECT state, epoch FROM jobs WHERE id = $1")
            .bind(&job)
            .fetch_optional(&self.pool)
            .await?;
        let Some(row) = row else {
            return Err(ServerError::LeaseLost(job));
        };
        let state: String = row.try_get("state")?;
        let state = JobState::from_name(&state).filter(|&state| state != JobState::Running);
        let ours = row.try_get::<i64, _>("epoch")? == lease.epoch;
        match state {
            Some(state) if ours => Ok(state),
            _ => Err(ServerError::LeaseLost(job)),
        }
    }

    /// Names files that a worker has put into the blob store, and removes the names in `gone`.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn keep_files(&self, lease: &Lease, kept: &[Kept], gone: &[String]) -> Result<()> {
        self.report(lease, Report::Files(kept, gone)).await
    }

    /// Applies one report, once. A lease belongs to one worker, whose reports are sequential.
    async fn report(&self, lease: &Lease, report: Report<'_>) -> Result<()> {
        let begun = Instant::now();
        // The number of reports before this one.
        let mut before = None;
        loop {
            let error = match self.report_once(lease, report, &mut before).await {
                Err(error) if self.may_pass(&error, begun) => error,
                reported => return reported,
            };
            tracing::warn!(%error, job = lease.job, "the database is unavailable; reporting again");
            tokio::time::sleep(PAUSE).await;
        }
    }

    pub(super) async fn report_once(
        &self,
        lease: &Lease,
        report: Report<'_>,
        before: &mut Option<i64>,
    ) -> Result<()> {
        let (mut tx, count) = self.fenced_with_count(lease).await?;
        if count > *before.get_or_insert(count) {
            // The transaction whose answer was lost was committed.
            return Ok(());
        }
        match report {
            Report::Event(event) => record(&mut tx, &lease.job, event).await?,
            Report::Progress(progress) => advance(&mut tx, &lease.job, progress).await?,
            Report::Files(kept, gone) => files::change(&mut tx, &lease.job, kept, gone).await?,
        }
        sqlx::query("UPDATE jobs SET told = told + 1 WHERE id = $1")
            .bind(&lease.job)
            .execute(&mut *tx)
            .await?;
        tx.commit().await
    }

    /// Returns whether a retry may succeed: a shared database may be briefly unavailable, and there
    /// is time left. A database file does not become unavailable, and SQLite itself waits for other
    /// writers.
    fn may_pass(&self, error: &ServerError, since: Instant) -> bool {
        self.engine == Engine::Postgres && since.elapsed() < PATIENCE && error.passes()
    }
}

/// Applies an event to the job and appends it.
pub(super) async fn record(tx: &mut Tx, job: &str, event: &Event) -> Result<()> {
    apply(tx, job, event).await?;
    let data = serde_json::to_value(event)
        .map_err(|error| ServerError::Damaged { what: "event", detail: error.to_string() })?;
    let kind = data["event"].as_str().unwrap_or("event").to_owned();
    events::append(tx, job, &kind, &data).await
}
