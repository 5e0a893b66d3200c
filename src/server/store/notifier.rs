//! Wakes those who wait for a change of the database: after each commit of this process, and where
//! PostgreSQL tells of the commit of another. A wake-up is a hint; the truth stands in the tables.

use std::convert::Infallible;
use std::time::Duration;

use sqlx::postgres::PgListener;
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use super::{Engine, Store, Tx};
use crate::error::Result;

/// The channel of PostgreSQL that carries changes of jobs.
const CHANNEL: &str = "fled_jobs";
/// The payload where a job waits; any other change of a job carries its id.
const WAITING: &str = "waiting";
/// Changes that other processes make wake this one at most this often: of a thousand running jobs
/// one changes all the time.
const PAUSE: Duration = Duration::from_millis(50);

/// What a transaction changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Change {
    /// A job, or what webhooks are to send.
    Job,
    /// A job, which waits since then.
    Queue,
}

/// Counts changes; a count that grows wakes its watchers.
#[derive(Debug, Default)]
pub(super) struct Notifier {
    changes: watch::Sender<u64>,
    queue: watch::Sender<u64>,
}

impl Notifier {
    pub(super) fn notify(&self, change: Change) {
        self.changes.send_modify(|count| *count += 1);
        if change == Change::Queue {
            self.queue.send_modify(|count| *count += 1);
        }
    }
}

impl Store {
    /// A count that grows with every change of a job.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.notifier.changes.subscribe()
    }

    /// A count that grows whenever a job may wait for a worker.
    pub fn queue(&self) -> watch::Receiver<u64> {
        self.notifier.queue.subscribe()
    }

    /// Passes on what other processes change, until the server stops. Every `look` it wakes
    /// everybody, whatever PostgreSQL tells. With SQLite there is no other process.
    pub async fn keep_listening(self, look: Duration, shutdown: CancellationToken) {
        let Some(url) = self.url.as_deref() else {
            return;
        };
        let listening = async {
            loop {
                let Err(error) = self.listen(url, look).await;
                tracing::warn!(%error, "cannot listen to the database: looking by itself");
                tokio::time::sleep(look).await;
                self.notifier.notify(Change::Queue);
            }
        };
        tokio::select! {
            () = listening => {}
            () = shutdown.cancelled() => {}
        }
    }

    /// Returns when the connection is lost, and with it what was told meanwhile.
    async fn listen(&self, url: &str, look: Duration) -> Result<Infallible> {
        let mut listener = PgListener::connect(url).await?;
        listener.listen(CHANNEL).await?;
        // The first tick comes at once: for what happened while nobody listened.
        let mut look = interval(look);
        let mut pause = interval(PAUSE);
        pause.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut has_changed = false;
        loop {
            tokio::select! {
                told = listener.recv() => match told?.payload() {
                    WAITING => self.notifier.notify(Change::Queue),
                    _ => has_changed = true,
                },
                _ = pause.tick(), if has_changed => {
                    has_changed = false;
                    self.notifier.notify(Change::Job);
                }
                _ = look.tick() => self.notifier.notify(Change::Queue),
            }
        }
    }
}

impl Tx {
    /// Wakes everybody who waits for a change of this job, once the transaction is committed.
    pub(super) async fn notify(&mut self, job: &str, change: Change) -> Result<()> {
        self.change = self.change.max(Some(change));
        if self.engine == Engine::Postgres {
            sqlx::query("SELECT pg_notify($1, $2)")
                .bind(CHANNEL)
                .bind(if change == Change::Queue { WAITING } else { job })
                .execute(&mut **self)
                .await?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::{of_a_server, of_each};

    #[tokio::test]
    async fn a_commit_wakes_those_who_wait_for_it_and_a_rollback_wakes_nobody() {
        for (_dir, store) in of_each().await {
            let (changes, queue) = (store.changes(), store.queue());
            let woken = || {
                let woken = |count: &watch::Receiver<u64>| count.has_changed().expect("open");
                (woken(&changes), woken(&queue))
            };
            let mut tx = store.begin().await.expect("begun");
            tx.notify("j", Change::Queue).await.expect("noted");
            tx.rollback().await.expect("rolled back");
            assert_eq!(woken(), (false, false));
            let mut tx = store.begin().await.expect("begun");
            tx.notify("j", Change::Job).await.expect("noted");
            assert_eq!(woken(), (false, false));
            tx.commit().await.expect("committed");
            assert_eq!(woken(), (true, false));
            let mut tx = store.begin().await.expect("begun");
            tx.notify("j", Change::Queue).await.expect("noted");
            tx.notify("j", Change::Job).await.expect("noted");
            tx.commit().await.expect("committed");
            assert_eq!(woken(), (true, true));
        }
    }

    #[tokio::test]
    async fn a_commit_of_another_process_wakes_those_who_wait_here() {
        let (_dir, here) = of_a_server().await;
        let url = here.url.clone().expect("PostgreSQL");
        let there = Store::at(&url).await.expect("open");
        let (mut queue, shutdown) = (here.queue(), CancellationToken::new());
        let rarely = Duration::from_secs(600);
        let listening = tokio::spawn(here.keep_listening(rarely, shutdown.clone()));
        // It listens now.
        queue.changed().await.expect("open");
        let mut tx = there.begin().await.expect("begun");
        tx.notify("j", Change::Queue).await.expect("noted");
        tx.commit().await.expect("committed");
        let woken = tokio::time::timeout(Duration::from_secs(30), queue.changed());
        woken.await.expect("in time").expect("open");
        shutdown.cancel();
        listening.await.expect("it ends");
    }
}
