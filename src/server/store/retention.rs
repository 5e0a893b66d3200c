//! Retention: jobs and captures are first marked, then deleted.

use std::time::Duration;

use super::Store;
use super::notifier::Change;
use crate::error::Result;

/// Rules of automatic deletion; off by default.
#[derive(Clone, Copy, Debug)]
pub struct Retention {
    /// Age after which finished jobs, and captures without jobs, are deleted.
    pub age: Option<Duration>,
    /// Number of newest finished jobs kept per owner.
    pub jobs: Option<u32>,
    /// How long before its deletion something is marked.
    pub notice: Duration,
}

impl Retention {
    /// Returns whether everything is kept.
    pub fn is_off(&self) -> bool {
        self.age.is_none() && self.jobs.is_none()
    }
}

impl Default for Retention {
    fn default() -> Self {
        Self { age: None, jobs: None, notice: Duration::from_secs(7 * 24 * 3600) }
    }
}

/// Ids of deleted jobs and captures.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Expired {
    /// Jobs whose folders are to be removed, including videos, which are deleted with their jobs.
    pub jobs: Vec<String>,
    /// Captures whose folders are to be removed.
    pub captures: Vec<String>,
}

impl Store {
    /// Marks what becomes due within the notice with its time of deletion, and unmarks what is no
    /// longer due because it was pinned, was queued again, or the server's retention has grown.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn mark_expiring(&self, retention: &Retention, now: i64) -> Result<()> {
        let notice = milliseconds(retention.notice);
        let age = retention.age.map(milliseconds);
        let mut tx = self.write().await?;
        sqlx::query(
            "WITH ended AS (
                SELECT jobs.id AS id, jobs.finished_at AS finished_at, ROW_NUMBER() OVER (
                    PARTITION BY captures.owner ORDER BY jobs.finished_at DESC, jobs.id DESC
                ) AS place
                FROM jobs JOIN captures ON captures.id = jobs.capture_id
                WHERE jobs.pinned = 0 AND jobs.finished_at IS NOT NULL AND jobs.video_of IS NULL
                AND jobs.state IN ('succeeded', 'failed', 'cancelled')
            ), due AS (
                SELECT id FROM ended
                WHERE ($3 IS NOT NULL AND place > $3)
                OR ($4 IS NOT NULL AND finished_at + $4 <= $1 + $2)
            )
            UPDATE jobs SET expires_at =
                CASE WHEN id IN (SELECT id FROM due) THEN COALESCE(expires_at, $1 + $2) END
            WHERE expires_at IS NOT NULL OR id IN (SELECT id FROM due)",
        )
        .bind(now)
        .bind(notice)
        .bind(retention.jobs.map(i64::from))
        .bind(age)
        .execute(&mut *tx)
        .await?;
        sqlx::query(
            "WITH due AS (
                SELECT id FROM captures
                WHERE $3 IS NOT NULL AND created_at + $3 <= $1 + $2
                AND NOT EXISTS (SELECT 1 FROM jobs WHERE capture_id = captures.id)
            )
            UPDATE captures SET expires_at =
                CASE WHEN id IN (SELECT id FROM due) THEN COALESCE(expires_at, $1 + $2) END
            WHERE expires_at IS NOT NULL OR id IN (SELECT id FROM due)",
        )
        .bind(now)
        .bind(notice)
        .bind(age)
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(())
    }

    /// Deletes the rows that were marked and have expired; a dry run deletes none but returns them.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn delete_expired(&self, now: i64, dry_run: bool) -> Result<Expired> {
        let mut tx = self.write().await?;
        let videos: Vec<String> = sqlx::query_scalar(
            "SELECT videos.id FROM jobs AS videos JOIN jobs ON jobs.id = videos.video_of
             WHERE jobs.expires_at <= $1 AND jobs.pinned = 0
             AND jobs.state IN ('succeeded', 'failed', 'cancelled')",
        )
        .bind(now)
        .fetch_all(&mut *tx)
        .await?;
        let mut jobs: Vec<String> = sqlx::query_scalar(
            "DELETE FROM jobs WHERE expires_at <= $1 AND pinned = 0
             AND state IN ('succeeded', 'failed', 'cancelled') RETURNING id",
        )
        .bind(now)
        .fetch_all(&mut *tx)
        .await?;
        let captures = sqlx::query_scalar(
            "DELETE FROM captures WHERE expires_at <= $1
             AND NOT EXISTS (SELECT 1 FROM jobs WHERE capture_id = captures.id) RETURNING id",
        )
        .bind(now)
        .fetch_all(&mut *tx)
        .await?;
        jobs.extend(videos);
        if dry_run {
            tx.rollback().await?;
        } else {
            for id in &jobs {
                tx.notify(id, Change::Job).await?;
            }
            tx.commit().await?;
        }
        Ok(Expired { jobs, captures })
    }

    /// Pins or unpins a job. `Ok(false)` if it does not exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn pin_job(&self, id: &str, pinned: bool) -> Result<bool> {
        let done = sqlx::query("UPDATE jobs SET pinned = $1, expires_at = NULL WHERE id = $2")
            .bind(i64::from(pinned))
            .bind(id)
            .execute(&self.pool)
            .await?;
        Ok(done.rows_affected() == 1)
    }
}

fn milliseconds(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).unwrap_or(i64::MAX / 4)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::{keep_capture, new_job, of_each, room};
    use crate::store::{NewJob, now_ms};

    const DAY: i64 = 24 * 3600 * 1000;
    const KEPT: Retention = Retention {
        age: Some(Duration::from_secs(30 * 24 * 3600)),
        jobs: Some(2),
        notice: Duration::from_secs(7 * 24 * 3600),
    };

    /// Creates a cancelled job; each call ends one slightly later than the call before.
    async fn ended(store: &Store, id: &str, capture: &str) {
        let job = NewJob { capture_id: capture.to_owned(), ..new_job(id) };
        let made = store.create_job(&job, None, "", room(100)).await;
        made.expect("made");
        store.request_cancel(id).await.expect("cancelled");
        tokio::time::sleep(Duration::from_millis(2)).await;
    }

    async fn stores() -> [(tempfile::TempDir, Store); 2] {
        let stores = of_each().await;
        for (_, store) in &stores {
            keep_capture(store, "anna's", Some("anna"), &[]).await;
            keep_capture(store, "ben's", Some("ben"), &[]).await;
            for id in ["a1", "a2", "a3"] {
                ended(store, id, "anna's").await;
            }
            ended(store, "b1", "ben's").await;
        }
        stores
    }

    async fn expires(store: &Store, id: &str) -> Option<i64> {
        store.job(id).await.expect("read").expect("is there").expires_at
    }

    #[tokio::test]
    async fn each_owners_oldest_excess_jobs_expire_after_the_notice() {
        for (_dir, store) in stores().await {
            let now = now_ms();
            store.mark_expiring(&KEPT, now).await.expect("marked");
            assert_eq!(expires(&store, "a1").await, Some(now + 7 * DAY));
            for kept in ["a2", "a3", "b1"] {
                assert_eq!(expires(&store, kept).await, None, "{kept}");
            }
            store.mark_expiring(&KEPT, now + DAY).await.expect("marked");
            assert_eq!(expires(&store, "a1").await, Some(now + 7 * DAY), "as announced");
            let early = store.delete_expired(now + 7 * DAY - 1, false).await;
            assert_eq!(early.expect("none"), Expired::default());
            let gone = store.delete_expired(now + 7 * DAY, false).await.expect("one");
            assert_eq!(gone.jobs, ["a1"]);
            assert!(gone.captures.is_empty());
        }
    }

    #[tokio::test]
    async fn a_pinned_job_stays_and_a_retried_one_expires_later() {
        for (_dir, store) in stores().await {
            let now = now_ms();
            let old = now + 24 * DAY;
            store.mark_expiring(&KEPT, old).await.expect("marked");
            assert_eq!(expires(&store, "b1").await, Some(old + 7 * DAY));
            assert!(store.pin_job("b1", true).await.expect("pinned"));
            assert!(!store.pin_job("none", true).await.expect("asked"));
            let again = store.retry("a1", room(100), None).await;
            again.expect("again");
            assert_eq!(expires(&store, "a1").await, None);
            store.mark_expiring(&KEPT, old + DAY).await.expect("marked");
            let gone = store.delete_expired(old + 9 * DAY, false).await.expect("two");
            assert_eq!(gone.jobs, ["a2", "a3"]);
            store.mark_expiring(&KEPT, old + DAY).await.expect("marked");
            assert_eq!(expires(&store, "b1").await, None, "it is pinned");
            store.pin_job("b1", false).await.expect("let go");
            store.mark_expiring(&KEPT, old + DAY).await.expect("marked");
            assert_eq!(expires(&store, "b1").await, Some(old + 8 * DAY));
            let all = Retention::default();
            store.mark_expiring(&all, old + DAY).await.expect("marked");
            assert_eq!(expires(&store, "b1").await, None, "all is kept now");
        }
    }

    #[tokio::test]
    async fn a_capture_expires_by_age_and_not_before_its_jobs() {
        for (_dir, store) in stores().await {
            let old = now_ms() + 40 * DAY;
            store.mark_expiring(&KEPT, old).await.expect("marked");
            let gone = store.delete_expired(old + 8 * DAY, false).await.expect("jobs");
            assert_eq!((gone.jobs.len(), gone.captures.len()), (4, 0));
            store.mark_expiring(&KEPT, old + 8 * DAY).await.expect("marked");
            ended(&store, "a4", "anna's").await;
            let gone = store.delete_expired(old + 15 * DAY, false).await.expect("one");
            assert_eq!(gone.captures, ["ben's"]);
        }
    }
}
