//! What replicas ask workers to do at once. A row is a question that somebody waits with: it is
//! removed by who asked, and may be lost.

use sqlx::Row;

use super::engine::counted;
use super::listen::ring;
use super::{Store, Tx};
use crate::error::Result;

/// How far an errand is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ErrandState {
    /// Nobody has taken it up.
    Asked,
    /// A worker does it.
    Taken {
        /// Whether that worker was not heard of for too long.
        is_lost: bool,
        /// So much is done.
        done: u32,
        /// Of so much; 0 where that is not known.
        total: u32,
    },
    /// What came of it, JSON.
    Answered(String),
}

/// What rings when a worker is asked for something of a kind.
pub fn errands_bell(worker: &str, kind: &str) -> String {
    format!("{worker}/{kind}")
}

impl Store {
    /// Asks a worker. `errand` is JSON. It is waited for as long as [`Store::want_errand`] says so
    /// once in `life_ms`.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn ask_errand(
        &self,
        id: &str,
        (worker, kind): (&str, &str),
        errand: &str,
        life_ms: i64,
    ) -> Result<()> {
        let mut tx = self.begin().await?;
        let now = tx.now;
        sqlx::query(
            "INSERT INTO errands (id, worker, kind, errand, asked_at, wanted_until)
             VALUES ($1, $2, $3, $4, $5, $6)",
        )
        .bind(id)
        .bind(worker)
        .bind(kind)
        .bind(errand)
        .bind(now)
        .bind(now + life_ms)
        .execute(&mut *tx)
        .await?;
        ring(&mut tx, &errands_bell(worker, kind)).await?;
        tx.commit().await
    }

    /// Who asked still waits for it.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn want_errand(&self, id: &str, life_ms: i64) -> Result<()> {
        let mut tx = self.begin().await?;
        let until = tx.now + life_ms;
        sqlx::query("UPDATE errands SET wanted_until = $1 WHERE id = $2")
            .bind(until)
            .bind(id)
            .execute(&mut *tx)
            .await?;
        tx.commit().await
    }

    /// Takes up the oldest that a worker is asked for, of a kind, and that somebody waits for; its
    /// id and what it is. The worker is taken for lost when it is not heard of for `life_ms`.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn take_errand(
        &self,
        (worker, kind): (&str, &str),
        life_ms: i64,
    ) -> Result<Option<(String, String)>> {
        let oldest = sqlx::query_as(
            "SELECT id, errand FROM errands
             WHERE worker = $1 AND kind = $2 AND taken_until IS NULL AND wanted_until >= $3
             ORDER BY asked_at, id LIMIT 1",
        );
        let oldest = oldest.bind(worker).bind(kind).bind(self.now().await?);
        // Mostly there is none: nothing is locked then.
        let oldest: Option<(String, String)> = oldest.fetch_optional(&self.pool).await?;
        let Some((id, errand)) = oldest else {
            return Ok(None);
        };
        let mut tx = self.begin().await?;
        let until = tx.now + life_ms;
        let taken = sqlx::query(
            "UPDATE errands SET taken_until = $1 WHERE id = $2 AND taken_until IS NULL",
        )
        .bind(until)
        .bind(&id)
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        // Else who asked has given it up meanwhile: the next look finds another.
        Ok((taken.rows_affected() == 1).then_some((id, errand)))
    }

    /// A worker still does it, and so far it is. `false` where nobody waits for it any more, or who
    /// did was not heard of for too long.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn extend_errand(
        &self,
        id: &str,
        worker: &str,
        (done, total): (u32, u32),
        life_ms: i64,
    ) -> Result<bool> {
        let mut tx = self.begin().await?;
        let now = tx.now;
        let until = now + life_ms;
        let extended = sqlx::query(
            "UPDATE errands SET taken_until = $1, done = $2, total = $3
             WHERE id = $4 AND worker = $5 AND outcome IS NULL AND wanted_until >= $6",
        )
        .bind(until)
        .bind(i64::from(done))
        .bind(i64::from(total))
        .bind(id)
        .bind(worker)
        .bind(now)
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(extended.rows_affected() == 1)
    }

    /// Says what came of it, JSON; the first answer holds. `false` where nobody waits for it.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn answer_errand(&self, id: &str, worker: &str, outcome: &str) -> Result<bool> {
        let mut tx = self.begin().await?;
        let answered = sqlx::query(
            "UPDATE errands SET outcome = $1 WHERE id = $2 AND worker = $3 AND outcome IS NULL",
        )
        .bind(outcome)
        .bind(id)
        .bind(worker)
        .execute(&mut *tx)
        .await?;
        ring(&mut tx, id).await?;
        tx.commit().await?;
        Ok(answered.rows_affected() == 1)
    }

    /// How far one is; `None` where it is not known.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn errand(&self, id: &str) -> Result<Option<ErrandState>> {
        let row =
            sqlx::query("SELECT taken_until, done, total, outcome FROM errands WHERE id = $1");
        let Some(row) = row.bind(id).fetch_optional(&self.pool).await? else {
            return Ok(None);
        };
        let (until, outcome): (Option<i64>, Option<String>) =
            (row.try_get("taken_until")?, row.try_get("outcome")?);
        Ok(Some(match (until, outcome) {
            (_, Some(outcome)) => ErrandState::Answered(outcome),
            (None, None) => ErrandState::Asked,
            (Some(until), None) => ErrandState::Taken {
                is_lost: until < self.now().await?,
                done: counted(row.try_get("done")?)?,
                total: counted(row.try_get("total")?)?,
            },
        }))
    }

    /// Whether a worker does something of a kind now, and is not lost over it.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn is_on_errand(&self, (worker, kind): (&str, &str)) -> Result<bool> {
        let busy = sqlx::query_scalar(
            "SELECT COUNT(*) FROM errands WHERE worker = $1 AND kind = $2 AND taken_until >= $3
             AND outcome IS NULL",
        );
        let busy = busy.bind(worker).bind(kind).bind(self.now().await?);
        let busy: i64 = busy.fetch_one(&self.pool).await?;
        Ok(busy > 0)
    }

    /// What workers do now and are not lost over: which of them, and of which kind.
    pub(super) async fn errands_under_way(&self) -> Result<Vec<(String, String)>> {
        let taken = "SELECT worker, kind FROM errands WHERE taken_until >= $1 AND outcome IS NULL
             ORDER BY worker, kind";
        let taken = sqlx::query_as(taken).bind(self.now().await?);
        Ok(taken.fetch_all(&self.pool).await?)
    }

    /// Asks for it no more, unless a worker has taken it up; whether that is so.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn withdraw_untaken(&self, id: &str) -> Result<bool> {
        let untaken = "DELETE FROM errands WHERE id = $1 AND taken_until IS NULL";
        let gone = sqlx::query(untaken).bind(id).execute(&self.pool).await?;
        Ok(gone.rows_affected() == 1)
    }

    /// Asks for it no more: who does it stops.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn withdraw_errand(&self, id: &str) -> Result<()> {
        let gone = sqlx::query("DELETE FROM errands WHERE id = $1").bind(id);
        gone.execute(&self.pool).await?;
        Ok(())
    }

    /// Forgets those that were asked for so long ago that who asked must have died.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn forget_errands(&self, age_ms: i64) -> Result<()> {
        let mut tx: Tx = self.begin().await?;
        let before = tx.now - age_ms;
        sqlx::query("DELETE FROM errands WHERE asked_at < $1")
            .bind(before)
            .execute(&mut *tx)
            .await?;
        tx.commit().await
    }
}
