//! Links to one job: tokens that open that job alone.

use sqlx::Row;
use sqlx::any::AnyRow;

use super::Store;
use crate::error::Result;
use crate::token::Digest;

/// A link to be kept.
#[derive(Clone, Debug)]
pub struct NewShare {
    /// Its public name.
    pub id: String,
    /// Whom or what it is for, in the maker's words.
    pub name: String,
    /// Of its secret.
    pub digest: Digest,
    /// The job that it opens.
    pub job: String,
    /// The token that makes it.
    pub made_by: String,
    /// What it allows.
    pub scopes: &'static str,
    /// Until when, milliseconds since 1970.
    pub expires_at: i64,
}

/// A kept link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ShareRow {
    /// Its public name.
    pub id: String,
    /// Whom or what it is for.
    pub name: String,
    /// Milliseconds since 1970.
    pub created_at: i64,
    /// Until when it holds.
    pub expires_at: i64,
    /// When it was last used, to a minute.
    pub last_used_at: Option<i64>,
}

/// Links of a job; the parameters are the job, and now.
const THAT_HOLD: &str = "FROM tokens WHERE job_id = $1 AND revoked_at IS NULL AND expires_at > $2
     AND NOT EXISTS (SELECT 1 FROM tokens AS maker
                     WHERE maker.id = tokens.made_by AND maker.revoked_at IS NOT NULL)";

impl Store {
    /// Keeps a link, unless its job has `most` that hold. `Ok(false)` when it has.
    ///
    /// # Errors
    /// When the database refuses; also for a job or a token that is not there.
    pub async fn insert_share(&self, share: &NewShare, most: u32) -> Result<bool> {
        let now = self.now().await?;
        let mut tx = self.write().await?;
        let count = sqlx::AssertSqlSafe(format!("SELECT count(*) {THAT_HOLD}"));
        let held: i64 = sqlx::query_scalar(count)
            .bind(&share.job)
            .bind(now)
            .fetch_one(&mut *tx)
            .await?;
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

    /// The links of a job that hold, newest first.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn shares(&self, job: &str) -> Result<Vec<ShareRow>> {
        let all = format!("SELECT * {THAT_HOLD} ORDER BY created_at DESC, id");
        let rows = sqlx::query(sqlx::AssertSqlSafe(all))
            .bind(job)
            .bind(self.now().await?)
            .fetch_all(&self.pool)
            .await?;
        rows.iter().map(from_row).collect()
    }

    /// Ends a link of a job. `Ok(false)` when there is none of this name that was not ended before.
    ///
    /// # Errors
    /// When the database refuses.
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
