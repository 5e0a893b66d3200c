//! Which looks for blobs that no file has were this database's own.

use super::Store;
use crate::error::Result;

/// All of so many milliseconds are known: as many replicas as there may be note theirs at one time.
const KNOWN_MS: i64 = 7 * 24 * 3600 * 1000;

impl Store {
    /// Whether a look of this name was this database's.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn has_collected(&self, id: &str) -> Result<bool> {
        let known = sqlx::query_scalar("SELECT COUNT(*) FROM collections WHERE id = $1");
        let known: i64 = known.bind(id).fetch_one(&self.pool).await?;
        Ok(known > 0)
    }

    /// Notes one that begins, and the mark that it has found. That one stays known for as long as
    /// none that follows comes so far as to replace it.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn note_collection(&self, id: &str, found: Option<&str>) -> Result<()> {
        let mut tx = self.begin().await?;
        let now = tx.now;
        sqlx::query("INSERT INTO collections (id, begun_at, found) VALUES ($1, $2, $3)")
            .bind(id)
            .bind(now)
            .bind(found)
            .execute(&mut *tx)
            .await?;
        sqlx::query(
            "DELETE FROM collections WHERE id <> $1 AND id <> $2
             AND (begun_at < $3 OR begun_at > $4)",
        )
        .bind(id)
        .bind(found.unwrap_or_default())
        .bind(now - KNOWN_MS)
        .bind(now + KNOWN_MS)
        .execute(&mut *tx)
        .await?;
        tx.commit().await
    }
}
