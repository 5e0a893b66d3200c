//! Browser sessions, stored as digests.

use sqlx::Row;
use subtle::ConstantTimeEq;

use super::Store;
use super::tokens::TokenRow;
use crate::error::Result;
use crate::token::Digest;

impl Store {
    /// Stores a session of a token and deletes expired sessions.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn insert_session(
        &self,
        digest: &Digest,
        token: &str,
        expires_at: i64,
    ) -> Result<()> {
        let now = self.now().await?;
        let mut tx = self.write().await?;
        sqlx::query("DELETE FROM sessions WHERE expires_at <= $1")
            .bind(now)
            .execute(&mut *tx)
            .await?;
        sqlx::query(
            "INSERT INTO sessions (digest, token_id, created_at, expires_at) VALUES ($1, $2, $3, $4)",
        )
        .bind(digest.as_slice())
        .bind(token)
        .bind(now)
        .bind(expires_at)
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(())
    }

    /// Returns the token of a session if both are valid now, and records the use of the token.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn token_of_session(&self, digest: &Digest) -> Result<Option<TokenRow>> {
        let row = sqlx::query(
            "SELECT sessions.digest AS session, tokens.digest AS token
             FROM sessions JOIN tokens ON tokens.id = sessions.token_id
             WHERE sessions.digest = $1 AND sessions.expires_at > $2",
        )
        .bind(digest.as_slice())
        .bind(self.now().await?)
        .fetch_optional(&self.pool)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let kept: Vec<u8> = row.try_get("session")?;
        let token: Vec<u8> = row.try_get("token")?;
        match Digest::try_from(token) {
            Ok(token) if bool::from(kept.ct_eq(digest)) => self.token_that_holds(&token).await,
            _ => Ok(None),
        }
    }

    /// Ends a session.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn end_session(&self, digest: &Digest) -> Result<()> {
        sqlx::query("DELETE FROM sessions WHERE digest = $1")
            .bind(digest.as_slice())
            .execute(&self.pool)
            .await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::now_ms;
    use crate::store::{NewToken, Quotas};
    use crate::token::Secret;

    #[tokio::test]
    async fn a_session_is_valid_no_longer_than_its_token() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let store = Store::open(&dir.path().join("fled.db")).await.expect("open");
        let secret = || Secret::new().expect("random").digest();
        let (token, session, over) = (secret(), secret(), secret());
        let kept = NewToken {
            id: "1".to_owned(),
            name: String::new(),
            digest: token,
            scopes: "jobs:read".parse().expect("scopes"),
            expires_at: None,
            quotas: Quotas::default(),
        };
        store.insert_token(&kept).await.expect("kept");
        let later = now_ms() + 60_000;
        store.insert_session(&over, "1", now_ms() - 1).await.expect("kept");
        store.insert_session(&session, "1", later).await.expect("kept");
        let held = async |digest| store.token_of_session(digest).await.expect("answer");
        assert_eq!(held(&session).await.expect("holds").id, "1");
        assert!(held(&over).await.is_none(), "it is over");
        assert!(held(&token).await.is_none(), "a token is no session");
        store.revoke_token("1").await.expect("answer");
        assert!(held(&session).await.is_none(), "its token is revoked");
        assert!(store.insert_session(&secret(), "2", later).await.is_err());
    }
}
