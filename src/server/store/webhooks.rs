//! Webhooks and their deliveries.

use serde_json::{Value, json};
use sqlx::Row;
use sqlx::any::AnyRow;

use super::engine::{Cells, counted};
use super::notifier::Change;
use super::outbox::{body, typed};
use super::{Engine, Store};
use crate::error::Result;

/// The type of a test delivery.
pub const TEST: &str = "webhook.test";

/// A webhook.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WebhookRow {
    /// Its public name.
    pub id: String,
    /// Where deliveries are sent.
    pub url: String,
    /// The key that signs deliveries.
    pub secret: Vec<u8>,
    /// Event types that it subscribes to.
    pub types: Vec<String>,
    /// Whose jobs it is notified of; `None` if the service had no tokens.
    pub owner: Option<String>,
    /// Whether it is notified of every owner's jobs.
    pub sees_all: bool,
    /// The token that created it.
    pub made_by: Option<String>,
    /// Milliseconds since 1970.
    pub created_at: i64,
    /// When its endpoint answered that it is gone.
    pub gone_at: Option<i64>,
}

/// A pending or past delivery.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeliveryRow {
    /// Its id, the same in every attempt.
    pub id: String,
    /// Its event type.
    pub kind: String,
    /// JSON, as signed and sent.
    pub body: String,
    /// Milliseconds since 1970.
    pub created_at: i64,
    /// Number of attempts so far.
    pub attempts: u32,
    /// When it is tried next; `None` once it has arrived or was abandoned.
    pub next_at: Option<i64>,
    /// When it arrived.
    pub delivered_at: Option<i64>,
    /// Outcome of the last attempt.
    pub answer: Option<String>,
}

/// Outcome of an attempt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tried {
    /// A description.
    pub answer: String,
    /// The next step.
    pub then: Then,
}

/// The next step after an attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Then {
    /// It arrived.
    Arrived,
    /// It is retried after this many milliseconds.
    After(i64),
    /// It is abandoned.
    GivenUp,
    /// It is abandoned, and the webhook is disabled.
    Gone,
}

/// How long a delivery stays claimed, in milliseconds: longer than any attempt.
const ON_ITS_WAY_MS: i64 = 120_000;

impl Store {
    /// Inserts a webhook unless its owner has `most` already, which returns `Ok(false)`.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn insert_webhook(&self, webhook: &WebhookRow, most: u32) -> Result<bool> {
        let mut tx = self.write().await?;
        let held =
            sqlx::query_scalar("SELECT count(*) FROM webhooks WHERE owner IS NOT DISTINCT FROM $1")
                .bind(&webhook.owner)
                .fetch_one(&mut *tx)
                .await?;
        if counted(held)? >= most {
            return Ok(false);
        }
        sqlx::query(
            "INSERT INTO webhooks (id, url, secret, types, owner, sees_all, made_by, created_at)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8)",
        )
        .bind(&webhook.id)
        .bind(&webhook.url)
        .bind(webhook.secret.as_slice())
        .bind(Value::from(webhook.types.clone()).to_string())
        .bind(&webhook.owner)
        .bind(i64::from(webhook.sees_all))
        .bind(&webhook.made_by)
        .bind(webhook.created_at)
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(true)
    }

    /// Returns the webhooks of an owner, or all, oldest first.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn webhooks(&self, owner: Option<&str>) -> Result<Vec<WebhookRow>> {
        let rows = sqlx::query(
            "SELECT * FROM webhooks WHERE $1 IS NULL OR owner = $1 ORDER BY created_at, id",
        )
        .bind(owner)
        .fetch_all(&self.pool)
        .await?;
        rows.iter().map(webhook).collect()
    }

    /// Returns the webhook with this id.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn webhook(&self, id: &str) -> Result<Option<WebhookRow>> {
        let row = sqlx::query("SELECT * FROM webhooks WHERE id = $1")
            .bind(id)
            .fetch_optional(&self.pool)
            .await?;
        row.as_ref().map(webhook).transpose()
    }

    /// Returns whether `owner` has this webhook.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn owns_webhook(&self, owner: &str, id: &str) -> Result<bool> {
        let row = self.webhook(id).await?;
        Ok(row.is_some_and(|row| row.owner.as_deref() == Some(owner)))
    }

    /// Deletes a webhook and its deliveries.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn delete_webhook(&self, id: &str) -> Result<()> {
        sqlx::query("DELETE FROM webhooks WHERE id = $1").bind(id).execute(&self.pool).await?;
        Ok(())
    }

    /// Inserts a test delivery and returns its id; `None` while another one is pending.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn test_webhook(&self, webhook: &str) -> Result<Option<String>> {
        let now = self.now().await?;
        let id = format!("msg_{}", uuid::Uuid::now_v7());
        let done = sqlx::query(
            "INSERT INTO deliveries (id, webhook_id, type, body, created_at, next_at)
             SELECT $1, $2, $3, $5, $4, $4
             WHERE NOT EXISTS (SELECT 1 FROM deliveries
                 WHERE webhook_id = $2 AND type = $3 AND next_at IS NOT NULL)",
        )
        .bind(&id)
        .bind(webhook)
        .bind(TEST)
        .bind(now)
        .bind(body(TEST, now, &json!({ "webhook_id": webhook })))
        .execute(&self.pool)
        .await?;
        self.notifier.notify(Change::Job);
        Ok((done.rows_affected() == 1).then_some(id))
    }

    /// Returns due deliveries with their webhooks: for each webhook outside `busy`, the delivery
    /// with the fewest attempts.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn due_deliveries(
        &self,
        busy: &[String],
        limit: u32,
    ) -> Result<Vec<(DeliveryRow, WebhookRow)>> {
        let due = format!(
            "SELECT * FROM (
                SELECT deliveries.*, attempts * 100000000000000 + next_at AS turn, ROW_NUMBER() OVER (
                    PARTITION BY webhook_id ORDER BY attempts * 100000000000000 + next_at, id
                ) AS place FROM deliveries
                WHERE next_at <= $1 AND webhook_id NOT IN ({})
             ) AS waiting WHERE place = 1 ORDER BY turn LIMIT $3",
            self.engine.listed("$2")
        );
        let rows = sqlx::query(sqlx::AssertSqlSafe(due))
            .bind(self.now().await?)
            .bind(Value::from(busy.to_vec()).to_string())
            .bind(i64::from(limit))
            .fetch_all(&self.pool)
            .await?;
        let mut due = Vec::with_capacity(rows.len());
        for row in &rows {
            let id: String = row.try_get("webhook_id")?;
            if let Some(webhook) = self.webhook(&id).await? {
                due.push((delivery(row)?, webhook));
            }
        }
        Ok(due)
    }

    /// When the next delivery is due, except to webhooks in `busy`.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn next_delivery(&self, busy: &[String]) -> Result<Option<i64>> {
        let next = format!(
            "SELECT min(next_at) FROM deliveries WHERE next_at IS NOT NULL
             AND webhook_id NOT IN ({})",
            self.engine.listed("$1")
        );
        let next = sqlx::query_scalar(sqlx::AssertSqlSafe(next));
        let busy = Value::from(busy.to_vec()).to_string();
        Ok(next.bind(busy).fetch_one(&self.pool).await?)
    }

    /// Returns whether a webhook may still receive deliveries: its token must be valid. A webhook
    /// created without a token is valid while the service has no tokens.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn webhook_holds(&self, webhook: &WebhookRow) -> Result<bool> {
        let holds = sqlx::query_scalar(
            "SELECT CASE WHEN $1 IS NULL
                 THEN (SELECT CASE WHEN COUNT(*) = 0 THEN 1 ELSE 0 END FROM tokens
                       WHERE job_id IS NULL)
                 ELSE (SELECT COUNT(*) FROM tokens WHERE id = $1 AND revoked_at IS NULL
                       AND (expires_at IS NULL OR expires_at > $2)) END",
        );
        let holds = holds.bind(&webhook.made_by).bind(self.now().await?);
        let holds: i64 = holds.fetch_one(&self.pool).await?;
        Ok(holds > 0)
    }

    /// Claims a delivery for a while, so that no other process sends it too; after a crash it is
    /// due again. `Ok(false)` if another process has claimed it. With SQLite there is no other
    /// process.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn take_delivery(&self, delivery: &mut DeliveryRow) -> Result<bool> {
        if self.engine == Engine::Sqlite {
            return Ok(true);
        }
        let until = self.now().await? + ON_ITS_WAY_MS;
        let done = sqlx::query(
            "UPDATE deliveries SET next_at = $1 WHERE id = $2 AND attempts = $3
             AND next_at IS NOT DISTINCT FROM $4",
        )
        .bind(until)
        .bind(&delivery.id)
        .bind(i64::from(delivery.attempts))
        .bind(delivery.next_at)
        .execute(&self.pool)
        .await?;
        delivery.next_at = Some(until);
        Ok(done.rows_affected() == 1)
    }

    /// Records the outcome of an attempt, unless a redelivery was requested meanwhile.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn note_attempt(&self, delivery: &DeliveryRow, tried: &Tried) -> Result<()> {
        let mut tx = self.write().await?;
        let now = tx.now;
        let (next, arrived) = match tried.then {
            Then::Arrived => (None, Some(now)),
            Then::After(wait_ms) => (Some(now + wait_ms), None),
            Then::GivenUp | Then::Gone => (None, None),
        };
        sqlx::query(
            "UPDATE deliveries SET attempts = attempts + 1, next_at = $1, delivered_at = $2,
             answer = $3 WHERE id = $4 AND attempts = $5
             AND next_at IS NOT DISTINCT FROM $6",
        )
        .bind(next)
        .bind(arrived)
        .bind(&tried.answer)
        .bind(&delivery.id)
        .bind(i64::from(delivery.attempts))
        .bind(delivery.next_at)
        .execute(&mut *tx)
        .await?;
        if tried.then == Then::Gone {
            sqlx::query(
                "UPDATE webhooks SET gone_at = $1
                 WHERE id = (SELECT webhook_id FROM deliveries WHERE id = $2)",
            )
            .bind(now)
            .bind(&delivery.id)
            .execute(&mut *tx)
            .await?;
        }
        tx.commit().await?;
        Ok(())
    }

    /// Returns the latest deliveries to a webhook, newest first.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn deliveries(&self, webhook: &str, limit: u32) -> Result<Vec<DeliveryRow>> {
        let rows = sqlx::query(
            "SELECT * FROM deliveries WHERE webhook_id = $1 ORDER BY created_at DESC, id LIMIT $2",
        )
        .bind(webhook)
        .bind(i64::from(limit))
        .fetch_all(&self.pool)
        .await?;
        rows.iter().map(delivery).collect()
    }

    /// Schedules a delivery to be sent at once, whatever its outcome. `Ok(false)` if it does not
    /// exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn redeliver(&self, webhook: &str, id: &str) -> Result<bool> {
        let done = sqlx::query(
            "UPDATE deliveries SET next_at = $1, attempts = 0 WHERE id = $2 AND webhook_id = $3",
        )
        .bind(self.now().await?)
        .bind(id)
        .bind(webhook)
        .execute(&self.pool)
        .await?;
        self.notifier.notify(Change::Job);
        Ok(done.rows_affected() == 1)
    }

    /// Deletes deliveries that were created before `before` and are no longer pending.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn forget_deliveries(&self, before: i64) -> Result<()> {
        sqlx::query("DELETE FROM deliveries WHERE created_at < $1 AND next_at IS NULL")
            .bind(before)
            .execute(&self.pool)
            .await?;
        Ok(())
    }
}

fn webhook(row: &AnyRow) -> Result<WebhookRow> {
    Ok(WebhookRow {
        id: row.try_get("id")?,
        url: row.try_get("url")?,
        secret: row.try_get("secret")?,
        types: typed(row)?,
        owner: row.try_get("owner")?,
        sees_all: row.flag("sees_all")?,
        made_by: row.try_get("made_by")?,
        created_at: row.try_get("created_at")?,
        gone_at: row.try_get("gone_at")?,
    })
}

fn delivery(row: &AnyRow) -> Result<DeliveryRow> {
    Ok(DeliveryRow {
        id: row.try_get("id")?,
        kind: row.try_get("type")?,
        body: row.try_get("body")?,
        created_at: row.try_get("created_at")?,
        attempts: row.count("attempts")?,
        next_at: row.try_get("next_at")?,
        delivered_at: row.try_get("delivered_at")?,
        answer: row.try_get("answer")?,
    })
}
