//! Tokens, stored as digests.

use sqlx::Row;
use sqlx::any::AnyRow;
use subtle::ConstantTimeEq;

use super::Store;
use super::engine::Cells;
use crate::error::Result;
use crate::token::{Digest, Scopes};

/// Minimum interval between updates of a token's last use, in milliseconds: reads should rarely
/// cause writes.
const NOTED_EVERY: i64 = 60_000;

/// A token to be created.
#[derive(Clone, Debug)]
pub struct NewToken {
    /// Its public name.
    pub id: String,
    /// The user's name for it.
    pub name: String,
    /// Digest of the token itself.
    pub digest: Digest,
    /// What it allows.
    pub scopes: Scopes,
    /// Expiry, in milliseconds since 1970; `None` for never.
    pub expires_at: Option<i64>,
    /// Limits for its owner.
    pub quotas: Quotas,
}

/// Limits for the owner of a token; `None` leaves only the server's own limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Quotas {
    /// Bytes of the owner's captures and results.
    pub bytes: Option<u64>,
    /// The owner's queued and running jobs.
    pub jobs: Option<u32>,
}

/// A stored token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenRow {
    /// Its public name.
    pub id: String,
    /// The user's name for it.
    pub name: String,
    /// What it allows.
    pub scopes: Scopes,
    /// Milliseconds since 1970.
    pub created_at: i64,
    /// Expiry, in milliseconds since 1970; `None` for never.
    pub expires_at: Option<i64>,
    /// When it was revoked.
    pub revoked_at: Option<i64>,
    /// When it was last used, to the minute.
    pub last_used_at: Option<i64>,
    /// Limits for its owner.
    pub quotas: Quotas,
    /// The only job it gives access to, if it is a share link.
    pub job: Option<String>,
}

impl TokenRow {
    /// The owner of its uploads: its name, so that a new token of the same name sees them too. A
    /// share link owns only its own, whatever its name.
    pub fn owner(&self) -> &str {
        if self.name.is_empty() || self.job.is_some() { &self.id } else { &self.name }
    }

    /// Returns whether it is valid at `now`, in milliseconds since 1970.
    pub fn holds(&self, now: i64) -> bool {
        self.revoked_at.is_none() && self.expires_at.is_none_or(|end| now < end)
    }
}

impl Store {
    /// Inserts a token.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn insert_token(&self, token: &NewToken) -> Result<()> {
        sqlx::query(
            "INSERT INTO tokens
             (id, name, digest, scopes, created_at, expires_at, quota_bytes, quota_jobs)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8)",
        )
        .bind(&token.id)
        .bind(&token.name)
        .bind(token.digest.as_slice())
        .bind(token.scopes.to_string())
        .bind(self.now().await?)
        .bind(token.expires_at)
        // More bytes than the database can count are unlimited.
        .bind(token.quotas.bytes.map(|bytes| i64::try_from(bytes).unwrap_or(i64::MAX)))
        .bind(token.quotas.jobs.map(i64::from))
        .execute(&self.pool)
        .await?;
        Ok(())
    }

    /// Returns all tokens ever created, oldest first, except share links.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn tokens(&self) -> Result<Vec<TokenRow>> {
        let rows = sqlx::query("SELECT * FROM tokens WHERE job_id IS NULL ORDER BY created_at, id")
            .fetch_all(&self.pool)
            .await?;
        rows.iter().map(from_row).collect()
    }

    /// Returns whether any token was ever created. Revoked and expired tokens count: their end must
    /// not open the service to everyone. A share link needs a token to create it.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn has_tokens(&self) -> Result<bool> {
        let any = sqlx::query("SELECT id FROM tokens LIMIT 1");
        Ok(any.fetch_optional(&self.pool).await?.is_some())
    }

    /// Revokes a token. `Ok(false)` if it does not exist or was revoked before.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn revoke_token(&self, id: &str) -> Result<bool> {
        let done =
            sqlx::query("UPDATE tokens SET revoked_at = $1 WHERE id = $2 AND revoked_at IS NULL")
                .bind(self.now().await?)
                .bind(id)
                .execute(&self.pool)
                .await?;
        Ok(done.rows_affected() == 1)
    }

    /// Returns the token with this digest if it is valid now and its creator is not revoked.
    /// Records its use.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn token_that_holds(&self, digest: &Digest) -> Result<Option<TokenRow>> {
        let row = sqlx::query(
            "SELECT * FROM tokens WHERE digest = $1 AND NOT EXISTS (
                 SELECT 1 FROM tokens AS maker
                 WHERE maker.id = tokens.made_by AND maker.revoked_at IS NOT NULL)",
        )
        .bind(digest.as_slice())
        .fetch_optional(&self.pool)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let kept: Vec<u8> = row.try_get("digest")?;
        let now = self.now().await?;
        let token = from_row(&row)?;
        if !bool::from(kept.ct_eq(digest)) || !token.holds(now) {
            return Ok(None);
        }
        if token.last_used_at.is_none_or(|last| now - last >= NOTED_EVERY) {
            let noted = sqlx::query("UPDATE tokens SET last_used_at = $1 WHERE id = $2")
                .bind(now)
                .bind(&token.id)
                .execute(&self.pool)
                .await;
            // A full disk must not lock anyone out.
            if let Err(error) = noted {
                tracing::warn!(%error, "cannot record the use of a token");
            }
        }
        Ok(Some(token))
    }
}

fn from_row(row: &AnyRow) -> Result<TokenRow> {
    let scopes: String = row.try_get("scopes")?;
    Ok(TokenRow {
        id: row.try_get("id")?,
        name: row.try_get("name")?,
        scopes: Scopes::stored(&scopes),
        created_at: row.try_get("created_at")?,
        expires_at: row.try_get("expires_at")?,
        revoked_at: row.try_get("revoked_at")?,
        last_used_at: row.try_get("last_used_at")?,
        quotas: Quotas {
            bytes: row.try_get::<Option<i64>, _>("quota_bytes")?.map(i64::unsigned_abs),
            jobs: row.count_if_any("quota_jobs")?,
        },
        job: row.try_get("job_id")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::now_ms;
    use crate::token::Secret;

    #[tokio::test]
    async fn a_token_holds_until_it_is_revoked_or_expires() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let store = Store::open(&dir.path().join("fled.db")).await.expect("open");
        assert!(!store.has_tokens().await.expect("answer"));
        let secrets = [(); 3].map(|()| Secret::new().expect("random"));
        for (index, secret) in secrets.iter().enumerate() {
            let token = NewToken {
                id: index.to_string(),
                name: "test".to_owned(),
                digest: secret.digest(),
                scopes: "renders".parse().expect("scopes"),
                expires_at: (index == 1).then(|| now_ms() - 1),
                quotas: Quotas {
                    bytes: (index == 2).then_some(1 << 40),
                    jobs: (index == 2).then_some(3),
                },
            };
            store.insert_token(&token).await.expect("kept");
        }
        let holds = async |index: usize| {
            let digest = secrets[index].digest();
            store.token_that_holds(&digest).await.expect("answer")
        };
        assert_eq!(holds(0).await.expect("holds").id, "0");
        assert!(holds(1).await.is_none(), "it has expired");
        assert!(store.revoke_token("0").await.expect("answer"));
        assert!(!store.revoke_token("0").await.expect("answer"), "it is ended");
        assert!(!store.revoke_token("none").await.expect("answer"));
        assert!(holds(0).await.is_none(), "it is revoked");
        let quotas = holds(2).await.expect("holds").quotas;
        assert_eq!((quotas.bytes, quotas.jobs), (Some(1 << 40), Some(3)));
        let unknown = crate::token::digest("fled_0");
        let unknown = store.token_that_holds(&unknown).await.expect("answer");
        assert!(unknown.is_none());
        let tokens = store.tokens().await.expect("tokens");
        assert!(tokens[0].last_used_at.is_some() && tokens[1].last_used_at.is_none());
        let content = std::fs::read(dir.path().join("fled.db-wal")).unwrap_or_default();
        let shows = |text: &str| content.windows(text.len()).any(|w| w == text.as_bytes());
        assert!(!secrets.iter().any(|secret| shows(secret.reveal())));
        store.revoke_token("2").await.expect("answer");
        assert!(store.has_tokens().await.expect("answer"), "it stays locked");
    }
}
