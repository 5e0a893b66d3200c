//! Compaction of a database.

use sqlx::Row;

use super::{Engine, Store, migrations};
use crate::error::{Result, ServerError};

impl Store {
    /// The schema version of this program.
    fn schema(&self) -> i64 {
        let known = match self.engine {
            Engine::Sqlite => migrations::SQLITE.last(),
            Engine::Postgres => migrations::POSTGRES.last(),
        };
        known.map_or(0, |(version, ..)| *version)
    }

    /// Checks that the schema is of this program's version.
    ///
    /// # Errors
    /// [`ServerError::Damaged`] if it is not.
    pub async fn check_version(&self) -> Result<()> {
        let applied =
            sqlx::query("SELECT COALESCE(MAX(version), 0) AS version FROM _sqlx_migrations")
                .fetch_one(&self.pool)
                .await?;
        let version: i64 = applied.try_get("version")?;
        let known = self.schema();
        if version == known {
            return Ok(());
        }
        Err(ServerError::Damaged {
            what: "schema",
            detail: format!(
                "it has version {version}, this program knows {known}: start the server of this \
                 program once, or use the program of that version"
            ),
        })
    }

    /// Returns the bytes of unused pages.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn unused_bytes(&self) -> Result<u64> {
        let pages: i64 = sqlx::query_scalar("PRAGMA freelist_count").fetch_one(&self.pool).await?;
        let size: i64 = sqlx::query_scalar("PRAGMA page_size").fetch_one(&self.pool).await?;
        Ok(u64::try_from(pages.saturating_mul(size)).unwrap_or(0))
    }

    /// Rewrites the database without unused pages and truncates its log. No other process may use
    /// it meanwhile.
    ///
    /// # Errors
    /// When the disk lacks space for both copies, or the database is in use.
    pub async fn compact(&self) -> Result<()> {
        for statement in ["VACUUM", "PRAGMA wal_checkpoint(TRUNCATE)"] {
            sqlx::query(statement).execute(&self.pool).await?;
        }
        Ok(())
    }
}
