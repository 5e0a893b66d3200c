//! One attempt to tell an address.

use std::time::Duration;

use tokio::sync::oneshot;

use super::sign::Signed;
use crate::egress::{agent, reason};

/// How long an address may take to answer.
const PATIENCE: Duration = Duration::from_secs(15);

/// Sends a delivery; the status of the answer, or why there is none. `inner`: whether addresses of
/// inner networks are told, too.
pub(super) async fn post(
    url: String,
    signed: Signed,
    body: String,
    inner: bool,
) -> Result<u16, String> {
    let (sender, receiver) = oneshot::channel();
    // A thread of its own: one that waits for a slow address keeps no server from stopping.
    let send = move || {
        // Nobody listens any more where the server stops.
        let _ = sender.send(send(&url, &signed, &body, inner));
    };
    let thread = std::thread::Builder::new().name("webhook".to_owned());
    thread.spawn(send).map_err(|error| error.to_string())?;
    receiver
        .await
        .map_err(|_| "the attempt was lost".to_owned())?
}

fn send(url: &str, signed: &Signed, body: &str, inner: bool) -> Result<u16, String> {
    let answer = agent(PATIENCE, inner)
        .post(url)
        .header("content-type", "application/json")
        .header("webhook-id", &signed.id)
        .header("webhook-timestamp", signed.timestamp.to_string())
        .header("webhook-signature", &signed.signature)
        .send(body);
    answer
        .map(|answer| answer.status().as_u16())
        .map_err(|error| reason(&error))
}
