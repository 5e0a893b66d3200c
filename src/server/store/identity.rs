//! The identity of this database, by which a blob store knows its owner. Earlier versions gave a
//! new one to every collection of blobs, hence the name of the table.

use uuid::Uuid;

use super::Store;
use crate::error::Result;

impl Store {
    /// Returns the identity of this database, and creates it on first use.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn identity(&self) -> Result<String> {
        let mut tx = self.write().await?;
        let known = "SELECT id FROM collections ORDER BY begun_at DESC, id DESC LIMIT 1";
        if let Some(known) = sqlx::query_scalar(known).fetch_optional(&mut *tx).await? {
            return Ok(known);
        }
        let identity = Uuid::now_v7().to_string();
        let now = tx.now;
        sqlx::query("INSERT INTO collections (id, begun_at) VALUES ($1, $2)")
            .bind(&identity)
            .bind(now)
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(identity)
    }

    /// Returns whether `identity` has been an identity of this database.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn is_known_as(&self, identity: &str) -> Result<bool> {
        let known = sqlx::query_scalar("SELECT COUNT(*) FROM collections WHERE id = $1");
        let known: i64 = known.bind(identity).fetch_one(&self.pool).await?;
        Ok(known > 0)
    }
}

#[cfg(test)]
mod tests {
    use crate::store::tests::of_each;

    #[tokio::test]
    async fn a_database_keeps_its_identity_and_recognises_earlier_ones() {
        for (_dir, store) in of_each().await {
            let first = store.identity().await.expect("made up");
            assert_eq!(store.identity().await.expect("kept"), first);
            let later = "INSERT INTO collections (id, begun_at) VALUES ('later', 4102444800000)";
            sqlx::query(later).execute(&store.pool).await.expect("kept");
            assert_eq!(store.identity().await.expect("read"), "later");
            for (identity, is_known) in [(&*first, true), ("later", true), ("disputed", false)] {
                let known = store.is_known_as(identity).await.expect("asked");
                assert_eq!(known, is_known, "{identity}");
            }
        }
    }
}
