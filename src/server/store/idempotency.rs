//! Creation of jobs, at most once per idempotency key.

use fled_blobs::Kept;
use sqlx::Row;

use super::captures::{self, CaptureRow};
use super::jobs::{JobRow, NewJob, insert, read};
use super::room::{Full, Room, full, unfinished, waiting};
use super::uploads::use_up;
use super::{Store, Tx, files};
use crate::error::{Result, ServerError};

/// Outcome of a request to create a job.
#[derive(Clone, Debug)]
pub enum Creation {
    /// A new job.
    Created(JobRow),
    /// The job that an earlier, identical request created.
    Replayed(JobRow),
    /// The key belongs to another request.
    KeyReused,
    /// The queue is full.
    QueueFull,
    /// Its owner's quota of jobs is used up.
    OverQuota,
}

/// A request to create a job, with what identifies it.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// The client's idempotency key.
    pub key: Option<&'a str>,
    /// Identifies the content of the request: a key reused with another fingerprint is refused.
    pub fingerprint: &'a str,
}

/// A capture made of uploads.
#[derive(Clone, Copy, Debug)]
pub struct UsedUp<'a> {
    /// The capture.
    pub capture: &'a CaptureRow,
    /// Its files in the blob store, if there is one.
    pub files: &'a [Kept],
    /// Ids of the uploads.
    pub uploads: &'a [String],
}

impl Store {
    /// Counts the queued jobs.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn waiting(&self) -> Result<u32> {
        waiting(&self.pool).await
    }

    /// Returns whether a request with this key has created a job.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn knows_key(&self, key: &str) -> Result<bool> {
        let known = "SELECT job_id FROM idempotency WHERE key = $1";
        let known = sqlx::query(known).bind(key);
        Ok(known.fetch_optional(&self.pool).await?.is_some())
    }

    /// Counts an owner's queued and running jobs.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn unfinished(&self, owner: &str) -> Result<u32> {
        unfinished(&self.pool, owner).await
    }

    /// Returns the outcome of an earlier request with this key, if there was one.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn answered(&self, request: &Request<'_>) -> Result<Option<Creation>> {
        seen(&mut self.begin().await?, request).await
    }

    /// Creates a job if there is room for it; with a key, at most once.
    ///
    /// `fingerprint` identifies the request: a key reused with another fingerprint is refused.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn create_job(
        &self,
        job: &NewJob,
        key: Option<&str>,
        fingerprint: &str,
        room: Room<'_>,
    ) -> Result<Creation> {
        // Immediate: two requests with one key queue here instead of both finding it unused.
        let mut tx = self.write().await?;
        let request = Request { key, fingerprint };
        if let Some(seen) = seen(&mut tx, &request).await? {
            return Ok(seen);
        }
        let creation = create(&mut tx, job, &request, room).await?;
        if matches!(creation, Creation::Created(_)) {
            tx.commit().await?;
        }
        Ok(creation)
    }

    /// Like [`Store::create_job`], together with the job's capture, whose files are already on
    /// disk. Without a job no row of the capture is kept. Deletes the uploads it is made of;
    /// `Ok(None)`, without effect, if one of them is gone.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn create_job_of(
        &self,
        used: UsedUp<'_>,
        job: &NewJob,
        request: &Request<'_>,
        room: Room<'_>,
    ) -> Result<Option<Creation>> {
        let mut tx = self.write().await?;
        if let Some(seen) = seen(&mut tx, request).await? {
            return Ok(Some(seen));
        }
        captures::insert(&mut tx, used.capture).await?;
        files::insert_of_capture(&mut tx, &used.capture.id, used.files).await?;
        if !use_up(&mut tx, used.uploads).await? {
            return Ok(None);
        }
        let creation = create(&mut tx, job, request, room).await?;
        if matches!(creation, Creation::Created(_)) {
            tx.commit().await?;
        }
        Ok(Some(creation))
    }
}

/// Returns what an earlier request with this key created, if it has a key.
async fn seen(tx: &mut Tx, request: &Request<'_>) -> Result<Option<Creation>> {
    let Some(key) = request.key else {
        return Ok(None);
    };
    let seen = sqlx::query("SELECT fingerprint, job_id FROM idempotency WHERE key = $1")
        .bind(key)
        .fetch_optional(&mut **tx)
        .await?;
    let Some(seen) = seen else { return Ok(None) };
    if seen.try_get::<String, _>("fingerprint")? != request.fingerprint {
        return Ok(Some(Creation::KeyReused));
    }
    let id: String = seen.try_get("job_id")?;
    let row = read(tx, &id).await?;
    Ok(Some(Creation::Replayed(row.ok_or_else(|| missing(&id))?)))
}

/// Inserts a job and its key. Commit only a [`Creation::Created`].
async fn create(
    tx: &mut Tx,
    job: &NewJob,
    request: &Request<'_>,
    room: Room<'_>,
) -> Result<Creation> {
    insert(tx, job).await?;
    match full(tx, room).await? {
        Some(Full::Queue) => return Ok(Creation::QueueFull),
        Some(Full::Quota) => return Ok(Creation::OverQuota),
        None => {}
    }
    if let Some(key) = request.key {
        sqlx::query(
            "INSERT INTO idempotency (key, fingerprint, job_id, created_at) VALUES ($1, $2, $3, $4)",
        )
        .bind(key)
        .bind(request.fingerprint)
        .bind(&job.id)
        .bind(tx.now)
        .execute(&mut **tx)
        .await?;
    }
    let row = read(tx, &job.id).await?.ok_or_else(|| missing(&job.id))?;
    Ok(Creation::Created(row))
}

fn missing(id: &str) -> ServerError {
    ServerError::Damaged { what: "idempotency key", detail: format!("its job {id} is gone") }
}
