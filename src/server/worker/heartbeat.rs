//! A worker's heartbeat. It runs in a task of its own, so that neither a slow blob store nor a full
//! pipe delays the extension of the lease.

use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior, interval};

use crate::app::App;
use crate::config::Limits;
use crate::error::ServerError;
use crate::failpoint::{Failpoint, Watcher};
use crate::store::{Lease, Store};

/// The outcome of a heartbeat that ends the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pulse {
    /// Cancellation was requested.
    Cancel,
    /// Another worker has the job, or may claim it soon: no heartbeat got through for too long.
    Lost,
}

/// A task that sends heartbeats until dropped.
#[derive(Debug)]
pub(super) struct Heartbeat {
    told: mpsc::Receiver<Pulse>,
    task: JoinHandle<()>,
}

impl Heartbeat {
    /// Starts to extend a lease that was just claimed.
    pub(super) fn begin(app: &App, lease: Lease) -> Self {
        let (tell, told) = mpsc::channel(1);
        let watcher = app.config.watcher;
        let task = tokio::spawn(heartbeat(app.store.clone(), app.limits, watcher, lease, tell));
        Self { told, task }
    }

    /// Waits for a pulse that ends the work.
    pub(super) async fn next(&mut self) -> Pulse {
        self.told.recv().await.unwrap_or(Pulse::Lost)
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
    tell: mpsc::Sender<Pulse>,
) {
    let mut ticks = interval(limits.heartbeat);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut heard = Instant::now();
    loop {
        ticks.tick().await;
        let asked = Instant::now();
        let left = limits.unheard.saturating_sub(heard.elapsed());
        let extended = store.heartbeat(&lease, limits.lease_ms());
        let answer = tokio::time::timeout(left, extended).await;
        let pulse = match answer {
            Ok(Ok(false)) => {
                // The lease counts from before the request to extend it.
                heard = asked;
                if let Some(watcher) = watcher {
                    watcher(Failpoint::Extended);
                }
                continue;
            }
            Ok(Ok(true)) => Pulse::Cancel,
            Ok(Err(ServerError::LeaseLost(_))) => Pulse::Lost,
            Ok(Err(error)) if heard.elapsed() < limits.unheard => {
                tracing::warn!(%error, job = lease.job, "cannot extend a lease");
                // Sooner than the next heartbeat, which may be the last.
                ticks.reset_after(limits.heartbeat / 10);
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
        if tell.send(pulse).await.is_err() {
            return;
        }
    }
}
