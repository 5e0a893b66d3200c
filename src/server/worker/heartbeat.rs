//! A worker's heartbeat. It runs in a separate task, so that neither a slow blob store nor a full
//! pipe delays the extension of the lease.

use std::time::Duration;

use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior, interval};

use crate::app::App;
use crate::config::Limits;
use crate::error::ServerError;
use crate::failpoint::{Failpoint, Watcher};
use crate::store::{Engine, Lease, Store};

/// The outcome of a heartbeat that ends the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pulse {
    /// Cancellation was requested.
    Cancel,
    /// Another worker has the job or may claim it soon: no heartbeat has succeeded for too long.
    Lost,
}

/// A task that sends heartbeats until dropped.
#[derive(Debug)]
pub(super) struct Heartbeat {
    pulses: mpsc::Receiver<Pulse>,
    task: JoinHandle<()>,
}

impl Heartbeat {
    /// Starts to extend a lease that was just claimed.
    pub(super) fn begin(app: &App, lease: Lease) -> Self {
        let (sender, pulses) = mpsc::channel(1);
        let watcher = app.config.watcher;
        let task = tokio::spawn(heartbeat(app.store.clone(), app.limits, watcher, lease, sender));
        Self { pulses, task }
    }

    /// Waits for a pulse that ends the work.
    pub(super) async fn next(&mut self) -> Pulse {
        self.pulses.recv().await.unwrap_or(Pulse::Lost)
    }
}

impl Drop for Heartbeat {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn heartbeat(
    store: Store,
    limits: Limits,
    watcher: Option<Watcher>,
    lease: Lease,
    sender: mpsc::Sender<Pulse>,
) {
    let mut ticks = interval(limits.heartbeat);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut extended_at = Instant::now();
    // With SQLite no other process can claim the job, however late a heartbeat is.
    let has_rivals = store.engine() != Engine::Sqlite;
    loop {
        ticks.tick().await;
        let requested_at = Instant::now();
        let unheard = if has_rivals { extended_at.elapsed() } else { Duration::ZERO };
        let left = limits.unheard.saturating_sub(unheard);
        let extended = store.heartbeat(&lease, limits.lease_ms());
        let answer = tokio::time::timeout(left, extended).await;
        let pulse = match answer {
            Ok(Ok(false)) => {
                // The lease counts from before the request to extend it.
                extended_at = requested_at;
                if let Some(watcher) = watcher {
                    watcher(Failpoint::Extended);
                }
                continue;
            }
            Ok(Ok(true)) => {
                extended_at = requested_at;
                // One message suffices; the lease is kept until the attempt has ended.
                let _ = sender.try_send(Pulse::Cancel);
                continue;
            }
            Ok(Err(ServerError::LeaseLost(_))) => Pulse::Lost,
            Ok(Err(error)) if unheard < limits.unheard => {
                tracing::warn!(%error, job = lease.job, "cannot extend a lease");
                // Sooner than the next regular heartbeat, which may be the last.
                ticks.reset_after(limits.heartbeat / 10);
                continue;
            }
            Err(_) if !has_rivals => {
                let seconds = extended_at.elapsed().as_secs();
                tracing::warn!(job = lease.job, seconds, "the database is slow; the job goes on");
                continue;
            }
            Ok(Err(_)) | Err(_) => {
                tracing::error!(
                    job = lease.job,
                    "this worker has no contact with the database; it stops its job"
                );
                Pulse::Lost
            }
        };
        // Nothing is left to extend.
        let _ = sender.send(pulse).await;
        return;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::{create, in_a_file, keep_capture, lock};
    use crate::store::{JobKind, Machine};

    /// A job that is just claimed, and limits of which each test changes what it needs.
    async fn claimed(store: &Store, limits: Limits) -> Lease {
        keep_capture(store, "c", None, &[]).await;
        create(store, "j").await;
        let claim = store.claim_fit(JobKind::Scene, "w", limits.lease_ms(), &[], Machine::ANY);
        claim.await.expect("claimed").expect("a job").lease
    }

    #[tokio::test]
    async fn a_database_that_is_slow_for_long_does_not_end_a_job_without_rivals() {
        let (_dir, store) = in_a_file().await;
        let (lease, heartbeat) = (Duration::from_millis(400), Duration::from_millis(40));
        let unheard = Duration::from_millis(200);
        let limits = Limits { lease, heartbeat, unheard, ..Limits::default() };
        let lease = claimed(&store, limits).await;
        let lock = lock(&store).await;
        let (sender, mut pulses) = mpsc::channel(1);
        let beats = tokio::spawn(super::heartbeat(store.clone(), limits, None, lease, sender));
        tokio::time::sleep(6 * unheard).await;
        assert!(pulses.try_recv().is_err(), "the job goes on");
        drop(lock);
        store.request_cancel("j").await.expect("cancelled");
        let pulse = tokio::time::timeout(Duration::from_secs(20), pulses.recv()).await;
        assert_eq!(pulse.expect("in time"), Some(Pulse::Cancel), "heartbeats go on");
        beats.abort();
    }

    #[tokio::test]
    async fn an_unread_cancellation_does_not_end_the_lease() {
        let (_dir, store) = in_a_file().await;
        let (lease, heartbeat) = (Duration::from_millis(400), Duration::from_millis(40));
        let limits = Limits { lease, heartbeat, ..Limits::default() };
        let lease = claimed(&store, limits).await;
        let (sender, mut pulses) = mpsc::channel(1);
        let beats = super::heartbeat(store.clone(), limits, None, lease, sender);
        let beats = tokio::spawn(beats);
        store.request_cancel("j").await.expect("cancelled");
        // Files are fetched for as long as two leases.
        tokio::time::sleep(2 * limits.lease).await;
        let lost = store.release_expired(|deaths| panic!("lost {deaths} times")).await;
        assert_eq!(lost.expect("looked"), [""; 0]);
        assert_eq!(pulses.recv().await, Some(Pulse::Cancel));
        beats.abort();
    }
}
