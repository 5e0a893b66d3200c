//! Retries of finished jobs.

use super::jobs::{Needs, change};
use super::room::{Full, Room, full};
use super::{Store, Tx};
use crate::error::Result;
use crate::store::state::Transition;
use serde_json::Value;

/// Outcome of a request to queue a job again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Retry {
    /// It is queued.
    Queued,
    /// It has not ended, has succeeded without a change of options, or is gone.
    WrongState,
    /// The queue is full.
    QueueFull,
    /// Its owner's quota of jobs is used up.
    OverQuota,
}

/// New options for a job.
#[derive(Clone, Debug)]
pub struct Change {
    /// Complete options.
    pub options: Value,
    /// Rounds that they request.
    pub rounds: u32,
    /// The machine that they require.
    pub needs: Needs,
}

impl Store {
    /// Queues a finished job again if there is room. Without `other` it must have failed or been
    /// cancelled; with other options any finished job is accepted.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn retry(&self, id: &str, room: Room<'_>, other: Option<&Change>) -> Result<Retry> {
        let transition = match other {
            None => Transition::Retried,
            Some(_) => Transition::Changed,
        };
        let mut tx = self.write().await?;
        let refused = if change(&mut tx, id, transition).await?.is_none() {
            Some(Retry::WrongState)
        } else {
            full(&mut tx, room).await?.map(|full| match full {
                Full::Queue => Retry::QueueFull,
                Full::Quota => Retry::OverQuota,
            })
        };
        if let Some(refused) = refused {
            // Roll back now, not when the connection is reused: until then the job stays locked.
            tx.rollback().await?;
            return Ok(refused);
        }
        if let Some(other) = other {
            apply(&mut tx, id, other).await?;
        }
        tx.commit().await?;
        Ok(Retry::Queued)
    }
}

/// Sets the options of a job and deletes its results. Results that are still valid are reported
/// again.
async fn apply(tx: &mut Tx, id: &str, other: &Change) -> Result<()> {
    sqlx::query(
        "UPDATE jobs SET options = $1, rounds = $2, round = 0, progress = 0, best_round = NULL,
         failed_at = 0, needs_gpu = $3, needs_memory = $4 WHERE id = $5",
    )
    .bind(other.options.to_string())
    .bind(i64::from(other.rounds))
    .bind(i64::from(other.needs.gpu))
    .bind(i64::try_from(other.needs.memory).unwrap_or(i64::MAX))
    .bind(id)
    .execute(&mut **tx)
    .await?;
    for forget in [
        "DELETE FROM rounds WHERE job_id = $1",
        "DELETE FROM stages WHERE job_id = $1",
        // It is no longer the result that shipped.
        "DELETE FROM warnings WHERE job_id = $1 AND code = 'recorded'",
        // Reused poses do not warn again.
        "DELETE FROM warnings WHERE job_id = $1 AND at > (
            SELECT MIN(at) FROM events WHERE job_id = $1 AND kind = 'stage_finished'
        )",
    ] {
        sqlx::query(forget).bind(id).execute(&mut **tx).await?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::store::NewJob;
    use crate::store::tests::{keep_capture, new_job, room};

    #[tokio::test]
    async fn a_finished_job_can_be_retried_with_other_options() {
        for (_dir, store) in crate::store::tests::of_each().await {
            goes_on(&store).await;
        }
    }

    async fn goes_on(store: &Store) {
        keep_capture(store, "c", Some("anna"), &[]).await;
        let job = NewJob { options: json!({ "cap": 1 }), ..new_job("j") };
        let room = room(9);
        store.create_job(&job, None, "", room).await.expect("made");
        let needs = Needs { gpu: true, memory: 1000 };
        let other = Change { options: json!({ "cap": 2 }), rounds: 1, needs };
        let retry = async |other| store.retry("j", room, other).await.expect("asked");
        assert_eq!(retry(Some(&other)).await, Retry::WrongState, "it waits");
        store.request_cancel("j").await.expect("cancelled");
        let none = Room { of_owner: Some(("anna", 0)), ..room };
        let refused = store.retry("j", none, Some(&other)).await;
        assert_eq!(refused.expect("asked"), Retry::OverQuota);
        let row = async || store.job("j").await.expect("read").expect("is there");
        assert_eq!(row().await.options, json!({ "cap": 1 }), "as it was");
        assert_eq!(retry(Some(&other)).await, Retry::Queued);
        assert_eq!(row().await.options, json!({ "cap": 2 }));
        assert_eq!((row().await.rounds, row().await.progress), (1, 0.0));
        assert_eq!(row().await.needs, needs);
    }
}
