//! Creating a job, at most once for a client's key.

use sqlx::Row;

use super::jobs::{Full, JobRow, NewJob, Room, full, insert, read, unfinished, waiting};
use super::{Store, now_ms};
use crate::error::{Result, ServerError};

/// What became of a request to create a job.
#[derive(Clone, Debug)]
pub enum Creation {
    /// A new job.
    Created(JobRow),
    /// The job that the same request had already created.
    Replayed(JobRow),
    /// The key belongs to another request.
    KeyReused,
    /// As many jobs wait as may.
    QueueFull,
    /// Its owner has as many jobs as their quota allows.
    OverQuota,
}

impl Store {
    /// How many jobs wait for a worker.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn waiting(&self) -> Result<u32> {
        waiting(&self.pool).await
    }

    /// Whether a request of this key has made a job.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn knows_key(&self, key: &str) -> Result<bool> {
        let known = "SELECT EXISTS (SELECT 1 FROM idempotency WHERE key = ?)";
        let known = sqlx::query_scalar(known).bind(key);
        Ok(known.fetch_one(&self.pool).await?)
    }

    /// How many jobs of an owner wait or run.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn unfinished(&self, owner: &str) -> Result<u32> {
        unfinished(&self.pool, owner).await
    }

    /// Creates a job where there is room for it; with a key, at most once.
    ///
    /// `fingerprint` identifies the request: the same key with another one is refused.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn create_job(
        &self,
        job: &NewJob,
        key: Option<&str>,
        fingerprint: &str,
        room: Room<'_>,
    ) -> Result<Creation> {
        // Immediate: two requests with one key queue here instead of both finding it unused.
        let mut tx = self.pool.begin_with("BEGIN IMMEDIATE").await?;
        if let Some(key) = key {
            let seen = sqlx::query("SELECT fingerprint, job_id FROM idempotency WHERE key = ?")
                .bind(key)
                .fetch_optional(&mut *tx)
                .await?;
            if let Some(seen) = seen {
                if seen.try_get::<String, _>("fingerprint")? != fingerprint {
                    return Ok(Creation::KeyReused);
                }
                let id: String = seen.try_get("job_id")?;
                let row = read(&mut tx, &id).await?;
                return Ok(Creation::Replayed(row.ok_or_else(|| missing(&id))?));
            }
        }
        insert(&mut tx, job).await?;
        match full(&mut tx, room).await? {
            Some(Full::Queue) => return Ok(Creation::QueueFull),
            Some(Full::Quota) => return Ok(Creation::OverQuota),
            None => {}
        }
        if let Some(key) = key {
            sqlx::query("INSERT INTO idempotency (key, fingerprint, job_id, created_at) VALUES (?, ?, ?, ?)")
                .bind(key)
                .bind(fingerprint)
                .bind(&job.id)
                .bind(now_ms())
                .execute(&mut *tx)
                .await?;
        }
        let row = read(&mut tx, &job.id)
            .await?
            .ok_or_else(|| missing(&job.id))?;
        tx.commit().await?;
        Ok(Creation::Created(row))
    }
}

fn missing(id: &str) -> ServerError {
    ServerError::Damaged {
        what: "idempotency key",
        detail: format!("its job {id} is gone"),
    }
}
