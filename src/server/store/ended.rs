//! Jobs that ran elsewhere and are stored as they ended.

use fled_blobs::Kept;
use fled_core::event::Event;

use super::captures::CaptureRow;
use super::effects::{Settlement, settle};
use super::jobs::{self, NewJob};
use super::report::record;
use super::state::JobState;
use super::{Store, captures, files};
use crate::error::Result;

/// A job that succeeded elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct Ended<'a> {
    /// The job.
    pub job: &'a NewJob,
    /// Its files in a shared blob store.
    pub files: &'a [Kept],
    /// What it reported, in order.
    pub events: &'a [Event],
    /// The delivered round.
    pub best_round: u32,
}

impl Store {
    /// Inserts a capture with a job that has ended, whose files are already on disk, or in the blob
    /// store as named. The job has no attempt and did not start here.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn insert_ended(
        &self,
        capture: &CaptureRow,
        kept: &[Kept],
        ended: Ended<'_>,
    ) -> Result<()> {
        let mut tx = self.write().await?;
        captures::insert(&mut tx, capture).await?;
        files::insert_of_capture(&mut tx, &capture.id, kept).await?;
        jobs::insert(&mut tx, ended.job).await?;
        let job = &ended.job.id;
        // Within the transaction only: no worker sees it.
        sqlx::query("UPDATE jobs SET state = $1 WHERE id = $2")
            .bind(JobState::Running.name())
            .bind(job)
            .execute(&mut *tx)
            .await?;
        for event in ended.events {
            record(&mut tx, job, event).await?;
        }
        files::change(&mut tx, job, ended.files, &[]).await?;
        settle(&mut tx, job, &Settlement::Finished { best_round: ended.best_round }).await?;
        tx.commit().await
    }
}
