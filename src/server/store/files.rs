//! Which files captures and jobs have in the store of files. A server that keeps its files in its
//! own directory has none here.

use std::collections::HashMap;

use fled_blobs::{Blob, Kept};
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, Row};

use super::{Store, Tx};
use crate::error::{Result, ServerError};

/// Files in one statement at most.
const AT_ONCE: usize = 200;

impl Store {
    /// The files of a capture.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn capture_files(&self, id: &str) -> Result<Vec<Kept>> {
        let files = "SELECT path, digest, bytes FROM capture_files WHERE capture_id = $1";
        let rows = sqlx::query(files).bind(id).fetch_all(&self.pool).await?;
        rows.iter().map(kept).collect()
    }

    /// A capture that has no files in the store of files, if there is one.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn capture_without_files(&self) -> Result<Option<String>> {
        let one = sqlx::query_scalar(
            "SELECT id FROM captures WHERE NOT EXISTS (
                 SELECT 1 FROM capture_files WHERE capture_files.capture_id = captures.id
             ) LIMIT 1",
        );
        Ok(one.fetch_optional(&self.pool).await?)
    }

    /// The files of a job and the version of them; `None` where there is no such job.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn job_files(&self, id: &str) -> Result<Option<(i64, Vec<Kept>)>> {
        // The version first: files that change meanwhile are newer, and are asked for again.
        let Some(version) = self.files_version(id).await? else {
            return Ok(None);
        };
        let files = "SELECT path, digest, bytes FROM job_files WHERE job_id = $1";
        let rows = sqlx::query(files).bind(id).fetch_all(&self.pool).await?;
        let files: Result<Vec<Kept>> = rows.iter().map(kept).collect();
        Ok(Some((version, files?)))
    }

    /// The version of a job's files: it grows with every change of them.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn files_version(&self, id: &str) -> Result<Option<i64>> {
        let version = sqlx::query_scalar("SELECT files_version FROM jobs WHERE id = $1").bind(id);
        Ok(version.fetch_optional(&self.pool).await?)
    }

    /// Names files that are no worker's, such as videos of a result, and forgets what is gone.
    /// `Ok(false)`, and nothing done, where the job is gone.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn add_files(&self, job: &str, kept: &[Kept], gone: &[String]) -> Result<bool> {
        let mut tx = self.begin().await?;
        let locked = format!("SELECT id FROM jobs WHERE id = $1{}", tx.engine.locking());
        let there = sqlx::query(sqlx::AssertSqlSafe(locked))
            .bind(job)
            .fetch_optional(&mut *tx)
            .await?;
        if there.is_none() {
            return Ok(false);
        }
        change(&mut tx, job, kept, gone).await?;
        tx.commit().await?;
        Ok(true)
    }

    /// Bytes that the files of these captures and jobs of an owner have in the store.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn bytes_of(&self, owner: &str) -> Result<u64> {
        let sum: i64 = sqlx::query_scalar(
            "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) FROM (
                SELECT capture_files.bytes AS bytes FROM capture_files
                JOIN captures ON captures.id = capture_files.capture_id WHERE captures.owner = $1
                UNION ALL
                SELECT job_files.bytes AS bytes FROM job_files
                JOIN jobs ON jobs.id = job_files.job_id
                JOIN captures ON captures.id = jobs.capture_id WHERE captures.owner = $1
            ) AS theirs",
        )
        .bind(owner)
        .fetch_one(&self.pool)
        .await?;
        Ok(u64::try_from(sum).unwrap_or(0))
    }

    /// Those of these digests that some file has.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn named(&self, digests: &[String]) -> Result<Vec<String>> {
        let listed = self.engine.listed("$1");
        let named = format!(
            "SELECT digest FROM capture_files WHERE digest IN ({listed})
             UNION SELECT digest FROM job_files WHERE digest IN ({listed})"
        );
        let named = sqlx::query_scalar(sqlx::AssertSqlSafe(named))
            .bind(serde_json::json!(digests).to_string());
        Ok(named.fetch_all(&self.pool).await?)
    }
}

/// The files of a new capture.
pub(super) async fn insert_of_capture(
    connection: &mut AnyConnection,
    capture: &str,
    files: &[Kept],
) -> Result<()> {
    for file in files {
        sqlx::query(
            "INSERT INTO capture_files (capture_id, path, digest, bytes) VALUES ($1, $2, $3, $4)",
        )
        .bind(capture)
        .bind(&file.path)
        .bind(&file.blob.digest)
        .bind(signed(file.blob.bytes))
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

pub(super) async fn change(tx: &mut Tx, job: &str, kept: &[Kept], gone: &[String]) -> Result<()> {
    for gone in gone.chunks(AT_ONCE) {
        let listed = tx.engine.listed("$2");
        let forget = format!("DELETE FROM job_files WHERE job_id = $1 AND path IN ({listed})");
        sqlx::query(sqlx::AssertSqlSafe(forget))
            .bind(job)
            .bind(serde_json::json!(gone).to_string())
            .execute(&mut **tx)
            .await?;
    }
    for file in kept {
        sqlx::query(
            "INSERT INTO job_files (job_id, path, digest, bytes) VALUES ($1, $2, $3, $4)
             ON CONFLICT (job_id, path) DO UPDATE SET digest = excluded.digest,
             bytes = excluded.bytes",
        )
        .bind(job)
        .bind(&file.path)
        .bind(&file.blob.digest)
        .bind(signed(file.blob.bytes))
        .execute(&mut **tx)
        .await?;
    }
    sqlx::query("UPDATE jobs SET files_version = files_version + 1 WHERE id = $1")
        .bind(job)
        .execute(&mut **tx)
        .await?;
    Ok(())
}

/// What is known of a job's files, by path.
pub fn by_path(files: Vec<Kept>) -> HashMap<String, Blob> {
    files
        .into_iter()
        .map(|file| (file.path, file.blob))
        .collect()
}

fn kept(row: &AnyRow) -> Result<Kept> {
    let bytes: i64 = row.try_get("bytes")?;
    Ok(Kept {
        path: row.try_get("path")?,
        blob: Blob {
            digest: row.try_get("digest")?,
            bytes: u64::try_from(bytes).map_err(|error| ServerError::Damaged {
                what: "file",
                detail: error.to_string(),
            })?,
        },
    })
}

fn signed(bytes: u64) -> i64 {
    i64::try_from(bytes).unwrap_or(i64::MAX)
}
