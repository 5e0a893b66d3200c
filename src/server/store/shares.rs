//! Share links: tokens that give access to one job.

use sqlx::Row;
use sqlx::any::AnyRow;

use super::Store;
use crate::error::Result;
use crate::token::Digest;

/// A share link to be created.
#[derive(Clone, Debug)]
pub struct NewShare {
    /// Its public name.
    pub id: String,
    /// Its recipient or purpose, as given by its creator.
    pub name: String,
    /// Digest of its secret.
    pub digest: Digest,
    /// The job it gives access to.
    pub job: String,
    /// The token that creates it.
    pub made_by: String,
    /// What it allows.
    pub scopes: &'static str,
    /// Expiry, in milliseconds since 1970.
    pub expires_at: i64,
}

/// A stored share link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ShareRow {
    /// Its public name.
    pub id: String,
    /// Its recipient or purpose.
    pub name: String,
    /// Milliseconds since 1970.
    pub created_at: i64,
    /// Expiry, in milliseconds since 1970.
    pub expires_at: i64,
    /// When it was last used, to the minute.
    pub last_used_at: Option<i64>,
}

/// The valid links of a job. The parameters are the job and the current time.
const THAT_HOLD: &str = "FROM tokens WHERE job_id = $1 AND revoked_at IS NULL AND expires_at > $2
     AND NOT EXISTS (SELECT 1 FROM tokens AS maker
                     WHERE maker.id = tokens.made_by AND maker.revoked_at IS NOT NULL)";

impl Store {
    /// Inserts a link unless its job has `most` valid ones, which returns `Ok(false)`.
    ///
    /// # Errors
    /// When a database operation fails, or the job or token does not exist.
    pub async fn insert_share(&self, share: &NewShare, most: u32) -> Result<bool> {
        let now = self.now().await?;
        let mut tx = self.write().await?;
        let count = sqlx::AssertSqlSafe(format!("SELECT count(*) {THAT_HOLD}"));
        let held: i64 =
            sqlx::query_scalar(count).bind(&share.job).bind(now).fetch_one(&mut *tx).await?;
        if held >= i64::from(most) {
            return Ok(false);
        }
        sqlx::query(
            "INSERT INTO tokens
             (id, name, digest, scopes, created_at, expires_at, job_id, made_by)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8)",
        )
        .bind(&share.id)
        .bind(&share.name)
        .bind(share.digest.as_slice())
        .bind(share.scopes)
        .bind(now)
        .bind(share.expires_at)
        .bind(&share.job)
        .bind(&share.made_by)
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(true)
    }

    /// Returns the valid links of a job, newest first.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn shares(&self, job: &str) -> Result<Vec<ShareRow>> {
        let all = format!("SELECT * {THAT_HOLD} ORDER BY created_at DESC, id");
        let rows = sqlx::query(sqlx::AssertSqlSafe(all))
            .bind(job)
            .bind(self.now().await?)
            .fetch_all(&self.pool)
            .await?;
        rows.iter().map(from_row).collect()
    }

    /// Revokes a link of a job. `Ok(false)` if it does not exist or was revoked before.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn end_share(&self, job: &str, id: &str) -> Result<bool> {
        let done = sqlx::query(
            "UPDATE tokens SET revoked_at = $1 WHERE id = $2 AND job_id = $3 AND revoked_at IS NULL",
        )
        .bind(self.now().await?)
        .bind(id)
        .bind(job)
        .execute(&self.pool)
        .await?;
        Ok(done.rows_affected() == 1)
    }
}

fn from_row(row: &AnyRow) -> Result<ShareRow> {
    Ok(ShareRow {
        id: row.try_get("id")?,
        name: row.try_get("name")?,
        created_at: row.try_get("created_at")?,
        expires_at: row.try_get("expires_at")?,
        last_used_at: row.try_get("last_used_at")?,
    })
}
