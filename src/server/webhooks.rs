//! Webhooks: notify other programs of jobs, according to Standard Webhooks 1.0.
//!
//! The transaction of an event inserts its deliveries into the database. This module sends each of
//! them, with retries for over a day, until it is acknowledged. A delivery may arrive twice, always
//! with the same id.

pub mod egress;
mod post;
mod sign;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::{self, JoinError, JoinSet};

use crate::app::App;
use crate::store::{DeliveryRow, Then, Tried, WebhookRow, now_ms};

pub use sign::{Secret, secret_text};

/// All event types.
pub const TYPES: [&str; 6] =
    ["job.queued", "job.running", "job.succeeded", "job.failed", "job.cancelled", "round.finished"];
/// The default event types.
pub const USUAL: [&str; 4] = ["job.succeeded", "job.failed", "job.cancelled", "round.finished"];

/// Waits after failed attempts, in seconds, as in Standard Webhooks; then the delivery is
/// abandoned, 28 hours after the event.
const WAITS: [i64; 7] = [5, 300, 1_800, 7_200, 18_000, 36_000, 36_000];
/// Maximum deliveries sent at a time.
const AT_ONCE: usize = 32;
/// Maximum time between two queries of the database: a clock may have been reset.
const LOOK_EVERY: Duration = Duration::from_secs(60);
/// Pause after a database error.
const AFTER_FAULT: Duration = Duration::from_secs(5);

/// Sends due deliveries until the server stops. Only one delivery per webhook is in flight, so a
/// slow endpoint delays only its own deliveries.
pub async fn keep_telling(app: Arc<App>) {
    let mut changes = app.store.changes();
    let mut in_flight = InFlight::new(AFTER_FAULT);
    loop {
        let wait = match send_due(&app, &mut in_flight).await {
            Ok(wait) => wait,
            Err(error) => {
                tracing::warn!(%error, "cannot look for webhook deliveries");
                AFTER_FAULT
            }
        };
        tokio::select! {
            () = tokio::time::sleep(wait) => {}
            _ = changes.changed() => {}
            Some(()) = in_flight.next_ended() => {}
            // Deliveries in flight are sent again at the next start.
            () = app.shutdown.cancelled() => return,
        }
    }
}

/// The tasks of deliveries in flight, at most one per webhook.
#[derive(Debug)]
struct InFlight {
    tasks: JoinSet<()>,
    webhooks: HashMap<task::Id, String>,
    /// How long a webhook pauses after a delivery has panicked.
    pause: Duration,
}

impl InFlight {
    fn new(pause: Duration) -> Self {
        Self { tasks: JoinSet::new(), webhooks: HashMap::new(), pause }
    }

    fn begin(&mut self, webhook: String, task: impl Future<Output = ()> + Send + 'static) {
        self.webhooks.insert(self.tasks.spawn(task).id(), webhook);
    }

    /// The webhooks with a delivery in flight.
    fn busy(&self) -> Vec<String> {
        self.webhooks.values().cloned().collect()
    }

    /// Waits until a task returns or panics; `None` if there is none. Cancel-safe.
    async fn next_ended(&mut self) -> Option<()> {
        let ended = self.tasks.join_next_with_id().await?;
        let id = ended.as_ref().map_or_else(JoinError::id, |(id, ())| *id);
        let webhook = self.webhooks.remove(&id);
        if let (Err(error), Some(webhook)) = (ended, webhook) {
            tracing::error!(%error, webhook, "a webhook's delivery failed in this server");
            // Its attempt is not recorded, so the delivery may be due at once.
            self.begin(webhook, tokio::time::sleep(self.pause));
        }
        Some(())
    }
}

/// Starts due deliveries within the limit, and returns how long to wait for the next.
async fn send_due(app: &Arc<App>, in_flight: &mut InFlight) -> crate::error::Result<Duration> {
    let busy = in_flight.busy();
    let room = AT_ONCE.saturating_sub(busy.len());
    if room == 0 {
        return Ok(LOOK_EVERY);
    }
    for (mut delivery, webhook) in app.store.due_deliveries(&busy, room as u32).await? {
        // Other processes that share the database find the delivery due too.
        if !app.store.take_delivery(&mut delivery).await? {
            continue;
        }
        in_flight.begin(webhook.id.clone(), deliver(app.clone(), delivery, webhook));
    }
    let next = app.store.next_delivery(&in_flight.busy()).await?;
    let now = app.store.now().await?;
    let wait = next.map_or(LOOK_EVERY, |next| {
        Duration::from_millis(u64::try_from(next - now).unwrap_or_default())
    });
    Ok(wait.min(LOOK_EVERY))
}

/// Makes one attempt and records its outcome.
async fn deliver(app: Arc<App>, delivery: DeliveryRow, webhook: WebhookRow) {
    let id = webhook.id.clone();
    let (attempts, sent) = (delivery.attempts, delivery.clone());
    let at = app.clone();
    let tried = outcome(attempts, async move { attempt(&at, &sent, &webhook).await }).await;
    tracing::info!(
        webhook = id,
        delivery = delivery.id,
        answer = tried.answer,
        "sent a webhook delivery"
    );
    if let Err(error) = app.store.note_attempt(&delivery, &tried).await {
        tracing::warn!(%error, "cannot record a webhook delivery");
        tokio::time::sleep(AFTER_FAULT).await;
    }
}

/// The outcome of an attempt after `attempts` others; a panic counts as a failure.
async fn outcome(attempts: u32, attempt: impl Future<Output = Tried> + Send + 'static) -> Tried {
    tokio::spawn(attempt).await.unwrap_or_else(|error| {
        tracing::error!(%error, "an attempt at a webhook's delivery panicked");
        Tried { then: again(attempts), answer: "the attempt failed in the server".to_owned() }
    })
}

async fn attempt(app: &App, delivery: &DeliveryRow, webhook: &WebhookRow) -> Tried {
    let failed = |answer: String| Tried { then: again(delivery.attempts), answer };
    let given_up = |answer: &str| Tried { answer: answer.to_owned(), then: Then::GivenUp };
    if webhook.gone_at.is_some() {
        return given_up("the endpoint has answered 410 Gone");
    }
    match app.store.webhook_holds(webhook).await {
        Ok(true) => {}
        Ok(false) => return given_up("the token that created the webhook is no longer valid"),
        Err(error) => return failed(error.to_string()),
    }
    let signed = sign::Signed::new(&webhook.secret, &delivery.id, now_ms() / 1000, &delivery.body);
    let inner = app.config.inner_webhooks;
    match post::post(webhook.url.clone(), signed, delivery.body.clone(), inner).await {
        Ok(status @ 200..=299) => Tried { answer: status.to_string(), then: Then::Arrived },
        Ok(410) => Tried {
            answer: "410: no more deliveries are sent to this endpoint".to_owned(),
            then: Then::Gone,
        },
        Ok(status) => failed(status.to_string()),
        Err(reason) => failed(reason),
    }
}

/// Returns the next step after another failed attempt.
fn again(attempts_before: u32) -> Then {
    let wait = WAITS.get(attempts_before as usize);
    wait.map_or(Then::GivenUp, |seconds| Then::After(seconds * 1000))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_deliveries_are_retried_for_over_a_day() {
        let mut hours = 0;
        for attempts in 0..WAITS.len() as u32 {
            match again(attempts) {
                Then::After(wait_ms) => hours += wait_ms,
                then => panic!("after {attempts}: {then:?}"),
            }
        }
        assert!(hours > 24 * 3_600_000, "{hours}");
        assert_eq!(again(WAITS.len() as u32), Then::GivenUp);
    }

    #[tokio::test]
    async fn an_attempt_that_panics_has_failed_and_is_retried() {
        let tried = outcome(0, async { panic!("a fault of this server") }).await;
        assert_eq!(tried.then, Then::After(WAITS[0] * 1000));
        assert!(!tried.answer.contains("a fault"), "it is shown to users: {}", tried.answer);
    }

    #[tokio::test]
    async fn a_panic_does_not_block_its_webhook() {
        let mut in_flight = InFlight::new(Duration::from_millis(1));
        in_flight.begin("a".to_owned(), std::future::pending());
        in_flight.begin("b".to_owned(), async { panic!("a fault of this server") });
        let minute = Duration::from_secs(60);
        for what in ["the delivery", "the pause"] {
            assert_eq!(in_flight.busy().len(), 2, "before {what} ends");
            let ended = tokio::time::timeout(minute, in_flight.next_ended()).await;
            assert_eq!(ended, Ok(Some(())), "{what}");
        }
        assert_eq!(in_flight.busy(), ["a"]);
    }
}
