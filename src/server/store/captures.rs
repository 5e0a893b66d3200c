//! Captures.

use fled_blobs::Kept;
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, Row};

use super::engine::Cells;
use super::uploads::use_up;
use super::{Store, files};
use crate::error::{Result, ServerError};

/// A stored capture.
#[derive(Clone, Debug, PartialEq)]
pub struct CaptureRow {
    /// UUID v7.
    pub id: String,
    /// The user's name for it.
    pub name: String,
    /// Number of usable photographs.
    pub accepted: u32,
    /// The assessments, as returned to clients.
    pub report: serde_json::Value,
    /// Milliseconds since 1970.
    pub created_at: i64,
    /// Its owner, and that of its jobs; `None` if the service had no tokens.
    pub owner: Option<String>,
    /// When it will be deleted, unless a job uses it.
    pub expires_at: Option<i64>,
}

impl Store {
    /// Inserts a capture whose files are already on disk, or in the blob store as named.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn insert_capture(&self, row: &CaptureRow, files: &[Kept]) -> Result<()> {
        let mut tx = self.write().await?;
        insert(&mut tx, row).await?;
        files::insert_of_capture(&mut tx, &row.id, files).await?;
        tx.commit().await
    }

    /// Like [`Store::insert_capture`], and deletes the uploads it is made of. `Ok(false)`, without
    /// effect, if one of them is gone.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn insert_capture_of(
        &self,
        row: &CaptureRow,
        files: &[Kept],
        uploads: &[String],
    ) -> Result<bool> {
        let mut tx = self.write().await?;
        insert(&mut tx, row).await?;
        files::insert_of_capture(&mut tx, &row.id, files).await?;
        if !use_up(&mut tx, uploads).await? {
            return Ok(false);
        }
        tx.commit().await?;
        Ok(true)
    }

    /// Returns the capture with this id.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn capture(&self, id: &str) -> Result<Option<CaptureRow>> {
        let row = sqlx::query("SELECT * FROM captures WHERE id = $1")
            .bind(id)
            .fetch_optional(&self.pool)
            .await?;
        row.as_ref().map(from_row).transpose()
    }

    /// Returns the newest captures older than `cursor`, newest first, of one owner or of all.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn captures(
        &self,
        limit: u32,
        cursor: Option<&str>,
        owner: Option<&str>,
    ) -> Result<Vec<CaptureRow>> {
        let rows = sqlx::query(
            "SELECT * FROM captures WHERE ($1 IS NULL OR id < $1) AND ($3 IS NULL OR owner = $3)
             ORDER BY id DESC LIMIT $2",
        )
        .bind(cursor)
        .bind(i64::from(limit))
        .bind(owner)
        .fetch_all(&self.pool)
        .await?;
        rows.iter().map(from_row).collect()
    }

    /// Returns whether `owner` has this capture.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn owns_capture(&self, owner: &str, id: &str) -> Result<bool> {
        let owns = "SELECT id FROM captures WHERE id = $1 AND owner = $2";
        let owns = sqlx::query(owns).bind(id).bind(owner);
        Ok(owns.fetch_optional(&self.pool).await?.is_some())
    }

    /// Returns whether `owner` has this job, through its capture.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn owns_job(&self, owner: &str, id: &str) -> Result<bool> {
        let owns = "SELECT jobs.id FROM jobs JOIN captures ON captures.id = jobs.capture_id
                WHERE jobs.id = $1 AND captures.owner = $2 AND jobs.video_of IS NULL";
        let owns = sqlx::query(owns).bind(id).bind(owner);
        Ok(owns.fetch_optional(&self.pool).await?.is_some())
    }

    /// Returns the ids of an owner's captures and of their jobs.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn belongings(&self, owner: &str) -> Result<(Vec<String>, Vec<String>)> {
        let captures = sqlx::query_scalar("SELECT id FROM captures WHERE owner = $1")
            .bind(owner)
            .fetch_all(&self.pool)
            .await?;
        let jobs = sqlx::query_scalar(
            "SELECT jobs.id FROM jobs JOIN captures ON captures.id = jobs.capture_id
             WHERE captures.owner = $1",
        )
        .bind(owner)
        .fetch_all(&self.pool)
        .await?;
        Ok((captures, jobs))
    }

    /// Deletes a capture without jobs. `Ok(false)` if it has a job.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn delete_capture(&self, id: &str) -> Result<bool> {
        let done = sqlx::query(
            "DELETE FROM captures WHERE id = $1 AND NOT EXISTS (SELECT 1 FROM jobs WHERE capture_id = $1)",
        )
        .bind(id)
        .execute(&self.pool)
        .await
        .map_err(ServerError::from);
        match done {
            // A job was created from it after the check.
            Err(error) if error.is_of_a_name() => Ok(false),
            done => Ok(done?.rows_affected() == 1),
        }
    }
}

pub(super) async fn insert(connection: &mut AnyConnection, row: &CaptureRow) -> Result<()> {
    sqlx::query(
        "INSERT INTO captures (id, name, accepted, report, created_at, owner)
         VALUES ($1, $2, $3, $4, $5, $6)",
    )
    .bind(&row.id)
    .bind(&row.name)
    .bind(i64::from(row.accepted))
    .bind(row.report.to_string())
    .bind(row.created_at)
    .bind(&row.owner)
    .execute(connection)
    .await?;
    Ok(())
}

fn from_row(row: &AnyRow) -> Result<CaptureRow> {
    let report: String = row.try_get("report")?;
    let report = serde_json::from_str(&report).map_err(|error| ServerError::Damaged {
        what: "capture report",
        detail: error.to_string(),
    })?;
    Ok(CaptureRow {
        id: row.try_get("id")?,
        name: row.try_get("name")?,
        accepted: row.count("accepted")?,
        report,
        created_at: row.try_get("created_at")?,
        owner: row.try_get("owner")?,
        expires_at: row.try_get("expires_at")?,
    })
}
