//! The webhook outbox.

use serde_json::{Value, json};
use sqlx::Row;
use sqlx::any::AnyRow;

use super::engine::Tx;
use crate::error::{Result, ServerError};

/// Inserts the webhook deliveries of an event, inside the transaction of its effect.
pub(super) async fn tell(tx: &mut Tx, job: &str, kind: &str, data: &Value) -> Result<()> {
    let event = match kind {
        "state" => format!("job.{}", data["state"].as_str().unwrap_or_default()),
        "round_finished" => "round.finished".to_owned(),
        _ => return Ok(()),
    };
    let addresses = sqlx::query(
        "SELECT w.id AS id, w.types AS types, j.name AS name, c.id AS capture,
                (SELECT MAX(seq) FROM events WHERE job_id = $1) AS seq
         FROM webhooks w
         JOIN jobs j ON j.id = $1 AND j.video_of IS NULL
         JOIN captures c ON c.id = j.capture_id
         WHERE w.gone_at IS NULL AND (w.sees_all = 1 OR w.owner IS NOT DISTINCT FROM c.owner)
             AND (CASE WHEN w.made_by IS NULL
                 THEN NOT EXISTS (SELECT 1 FROM tokens WHERE job_id IS NULL)
                 ELSE EXISTS (SELECT 1 FROM tokens t WHERE t.id = w.made_by
                     AND t.revoked_at IS NULL AND (t.expires_at IS NULL OR t.expires_at > $2))
                 END)",
    )
    .bind(job)
    .bind(tx.now)
    .fetch_all(&mut **tx)
    .await?;
    for address in addresses {
        let types: Vec<String> = typed(&address)?;
        if !types.contains(&event) {
            continue;
        }
        let id: String = address.try_get("id")?;
        let seq: i64 = address.try_get("seq")?;
        let mut about = data.clone();
        if let Some(about) = about.as_object_mut() {
            about.remove("event");
            about.insert("job_id".to_owned(), job.into());
            let capture: String = address.try_get("capture")?;
            about.insert("capture_id".to_owned(), capture.into());
            let name: String = address.try_get("name")?;
            about.insert("name".to_owned(), name.into());
        }
        sqlx::query(
            "INSERT INTO deliveries (id, webhook_id, type, body, created_at, next_at)
             VALUES ($1, $2, $3, $4, $5, $5)",
        )
        .bind(format!("msg_{job}_{seq}_{id}"))
        .bind(id)
        .bind(&event)
        .bind(body(&event, tx.now, &about))
        .bind(tx.now)
        .execute(&mut **tx)
        .await?;
    }
    Ok(())
}

/// The body of a delivery.
pub(super) fn body(kind: &str, at: i64, data: &Value) -> String {
    let at = jiff::Timestamp::from_millisecond(at).unwrap_or(jiff::Timestamp::UNIX_EPOCH);
    json!({ "type": kind, "timestamp": format!("{at:.3}"), "data": data }).to_string()
}

/// The event types that a webhook subscribes to.
pub(super) fn typed(row: &AnyRow) -> Result<Vec<String>> {
    let types: String = row.try_get("types")?;
    serde_json::from_str(&types)
        .map_err(|error| ServerError::Damaged { what: "webhook", detail: error.to_string() })
}
