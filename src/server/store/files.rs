//! Names of the files of captures and jobs in the blob store. A server that keeps its files in its
//! data directory has none here.

use std::collections::HashMap;

use fled_blobs::{Blob, Kept};
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, Row};

use super::{Store, Tx};
use crate::error::{Result, ServerError};

/// Maximum files in one statement.
const AT_ONCE: usize = 200;

impl Store {
    /// Returns the files of a capture.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn capture_files(&self, id: &str) -> Result<Vec<Kept>> {
        let files = "SELECT path, digest, bytes FROM capture_files WHERE capture_id = $1";
        let rows = sqlx::query(files).bind(id).fetch_all(&self.pool).await?;
        rows.iter().map(kept).collect()
    }

    /// Returns a capture without files in the blob store, if there is one.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn capture_without_files(&self) -> Result<Option<String>> {
        let one = sqlx::query_scalar(
            "SELECT id FROM captures WHERE NOT EXISTS (
                 SELECT 1 FROM capture_files WHERE capture_files.capture_id = captures.id
             ) LIMIT 1",
        );
        Ok(one.fetch_optional(&self.pool).await?)
    }

    /// Returns the files of a job and their version; `None` if the job does not exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn job_files(&self, id: &str) -> Result<Option<(i64, Vec<Kept>)>> {
        // Version first: files that change in between are newer, and the next check fetches them
        // again.
        let Some(version) = self.files_version(id).await? else {
            return Ok(None);
        };
        let files = "SELECT path, digest, bytes FROM job_files WHERE job_id = $1";
        let rows = sqlx::query(files).bind(id).fetch_all(&self.pool).await?;
        let files: Result<Vec<Kept>> = rows.iter().map(kept).collect();
        Ok(Some((version, files?)))
    }

    /// Returns the version of a job's files, which grows with every change.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn files_version(&self, id: &str) -> Result<Option<i64>> {
        let version = sqlx::query_scalar("SELECT files_version FROM jobs WHERE id = $1").bind(id);
        Ok(version.fetch_optional(&self.pool).await?)
    }

    /// Bytes that the files of these captures and jobs of an owner have in the store.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn bytes_of(&self, owner: &str) -> Result<u64> {
        let sum: i64 = sqlx::query_scalar(
            "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) FROM (
                SELECT capture_files.bytes AS bytes FROM capture_files
                JOIN captures ON captures.id = capture_files.capture_id WHERE captures.owner = $1
                AND capture_files.path NOT LIKE '.thumbnails/%'
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

    /// Returns those of these digests that belong to a file.
    ///
    /// # Errors
    /// When a database operation fails.
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

/// Inserts the files of a new capture.
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

/// Indexes a job's files by path.
pub fn by_path(files: Vec<Kept>) -> HashMap<String, Blob> {
    files.into_iter().map(|file| (file.path, file.blob)).collect()
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
