//! Resumable uploads.

use std::collections::HashMap;

use serde_json::json;
use sqlx::Row;
use sqlx::any::AnyRow;

use super::{Store, Tx};
use crate::error::{Result, ServerError};

/// A resumable upload, unfinished or not yet part of a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UploadRow {
    /// UUID v7.
    pub id: String,
    /// Its owner; `None` if the service had no tokens.
    pub owner: Option<String>,
    /// Its file name, as sent.
    pub filename: String,
    /// `Upload-Metadata`, as sent.
    pub metadata: String,
    /// Total bytes.
    pub length: u64,
    /// Milliseconds since 1970.
    pub created_at: i64,
    /// When it expires unless more data arrives, in milliseconds since 1970.
    pub expires_at: i64,
}

impl Store {
    /// Inserts an upload whose empty file is on disk, if its owner has fewer than `most`; otherwise
    /// `Ok(false)`.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn insert_upload(&self, row: &UploadRow, most: u32) -> Result<bool> {
        let done = sqlx::query(
            "INSERT INTO uploads (id, owner, filename, metadata, length, created_at, expires_at)
             SELECT $1, $2, $3, $4, $5, $6, $7 WHERE $8 >
             (SELECT COUNT(*) FROM uploads WHERE owner IS NOT DISTINCT FROM $2)",
        )
        .bind(&row.id)
        .bind(&row.owner)
        .bind(&row.filename)
        .bind(&row.metadata)
        .bind(signed(row.length))
        .bind(row.created_at)
        .bind(row.expires_at)
        .bind(i64::from(most))
        .execute(&self.pool)
        .await?;
        Ok(done.rows_affected() == 1)
    }

    /// Returns the upload with this id unless it has expired.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn upload(&self, id: &str) -> Result<Option<UploadRow>> {
        let row = sqlx::query("SELECT * FROM uploads WHERE id = $1 AND expires_at > $2")
            .bind(id)
            .bind(self.now().await?)
            .fetch_optional(&self.pool)
            .await?;
        row.as_ref().map(from_row).transpose()
    }

    /// Returns the unexpired uploads among `ids`, by id.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn uploads(&self, ids: &[String]) -> Result<HashMap<String, UploadRow>> {
        let these = format!(
            "SELECT * FROM uploads WHERE id IN ({}) AND expires_at > $2",
            self.engine.listed("$1")
        );
        let rows = sqlx::query(sqlx::AssertSqlSafe(these))
            .bind(json!(ids).to_string())
            .bind(self.now().await?)
            .fetch_all(&self.pool)
            .await?;
        let by_id = |row| from_row(row).map(|row| (row.id.clone(), row));
        rows.iter().map(by_id).collect()
    }

    /// Returns whether `owner` has this upload.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn owns_upload(&self, owner: &str, id: &str) -> Result<bool> {
        let owns = "SELECT id FROM uploads WHERE id = $1 AND owner = $2";
        let owns = sqlx::query(owns).bind(id).bind(owner);
        Ok(owns.fetch_optional(&self.pool).await?.is_some())
    }

    /// Total bytes of all uploads of an owner, including expired ones whose files still exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn bytes_of_uploads(&self, owner: &str) -> Result<u64> {
        let sum = "SELECT CAST(COALESCE(SUM(length), 0) AS BIGINT) FROM uploads WHERE owner = $1";
        let sum = sqlx::query_scalar(sum).bind(owner);
        let sum: i64 = sum.fetch_one(&self.pool).await?;
        Ok(u64::try_from(sum).unwrap_or(0))
    }

    /// Postpones the expiry of an upload. `Ok(false)` if the upload does not exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn touch_upload(&self, id: &str, expires_at: i64) -> Result<bool> {
        let done = sqlx::query("UPDATE uploads SET expires_at = $1 WHERE id = $2")
            .bind(expires_at)
            .bind(id)
            .execute(&self.pool)
            .await?;
        Ok(done.rows_affected() == 1)
    }

    /// Deletes an upload; with `by`, only if it has expired by then. `Ok(false)` if no row was
    /// deleted.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn forget_upload(&self, id: &str, by: Option<i64>) -> Result<bool> {
        let done =
            sqlx::query("DELETE FROM uploads WHERE id = $1 AND ($2 IS NULL OR expires_at <= $2)")
                .bind(id)
                .bind(by)
                .execute(&self.pool)
                .await?;
        Ok(done.rows_affected() == 1)
    }

    /// Returns the ids of uploads that have expired by `by`.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn expired_uploads(&self, by: i64) -> Result<Vec<String>> {
        let expired = sqlx::query_scalar("SELECT id FROM uploads WHERE expires_at <= $1").bind(by);
        Ok(expired.fetch_all(&self.pool).await?)
    }

    /// Deletes all uploads, for a copy that lacks their files.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn forget_uploads(&self) -> Result<()> {
        let forget = sqlx::query("DELETE FROM uploads");
        forget.execute(&self.pool).await?;
        Ok(())
    }
}

/// Deletes these uploads and returns whether all of them existed.
pub(super) async fn use_up(tx: &mut Tx, ids: &[String]) -> Result<bool> {
    let these = format!("DELETE FROM uploads WHERE id IN ({})", tx.engine.listed("$1"));
    let done = sqlx::query(sqlx::AssertSqlSafe(these))
        .bind(json!(ids).to_string())
        .execute(&mut **tx)
        .await?;
    Ok(done.rows_affected() == ids.len() as u64)
}

fn from_row(row: &AnyRow) -> Result<UploadRow> {
    Ok(UploadRow {
        id: row.try_get("id")?,
        owner: row.try_get("owner")?,
        filename: row.try_get("filename")?,
        metadata: row.try_get("metadata")?,
        length: unsigned(row.try_get("length")?)?,
        created_at: row.try_get("created_at")?,
        expires_at: row.try_get("expires_at")?,
    })
}

/// No upload is longer than an `i64` can represent.
fn signed(bytes: u64) -> i64 {
    i64::try_from(bytes).unwrap_or(i64::MAX)
}

fn unsigned(bytes: i64) -> Result<u64> {
    u64::try_from(bytes)
        .map_err(|error| ServerError::Damaged { what: "upload", detail: error.to_string() })
}
