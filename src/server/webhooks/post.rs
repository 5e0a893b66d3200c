//! One attempt at a delivery.

use std::time::Duration;

use tokio::sync::oneshot;

use super::sign::Signed;
use crate::webhooks::egress::{agent, reason};

/// How long an endpoint may take to answer.
const PATIENCE: Duration = Duration::from_secs(15);

/// Sends a delivery and returns the status of the answer, or the reason why there is none. `inner`
/// allows addresses in internal networks.
pub(super) async fn post(
    url: String,
    signed: Signed,
    body: String,
    inner: bool,
) -> Result<u16, String> {
    let (sender, receiver) = oneshot::channel();
    // A dedicated thread: waiting for a slow endpoint does not delay the server's stop.
    let send = move || {
        // When the server stops, no one receives this.
        let _ = sender.send(send(&url, &signed, &body, inner));
    };
    let thread = std::thread::Builder::new().name("webhook".to_owned());
    thread.spawn(send).map_err(|error| error.to_string())?;
    receiver.await.map_err(|_| "the attempt was lost".to_owned())?
}

fn send(url: &str, signed: &Signed, body: &str, inner: bool) -> Result<u16, String> {
    let answer = agent(PATIENCE, inner)
        .post(url)
        .header("content-type", "application/json")
        .header("webhook-id", &signed.id)
        .header("webhook-timestamp", signed.timestamp.to_string())
        .header("webhook-signature", &signed.signature)
        .send(body);
    answer.map(|answer| answer.status().as_u16()).map_err(|error| reason(&error))
}
