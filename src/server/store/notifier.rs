//! Wakes tasks that wait for a database change: after each commit of this process, and when
//! PostgreSQL reports another process's commit. A wake-up is only a hint; the tables are
//! authoritative.

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
/// The payload if a job is queued; any other change of a job carries the job's id.
const WAITING: &str = "waiting";
/// Changes by other processes wake this one at most this often: with a thousand running jobs, one
/// of them changes all the time.
const PAUSE: Duration = Duration::from_millis(50);

/// The change that a transaction makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Change {
    /// A job, or pending webhook deliveries.
    Job,
    /// A job that is now queued.
    Queue,
}

/// Counts changes; an increase wakes the watchers.
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

    /// A count that grows whenever a job may be ready for a worker.
    pub fn queue(&self) -> watch::Receiver<u64> {
        self.notifier.queue.subscribe()
    }

    /// Passes on changes by other processes, until the server stops. Wakes all watchers every
    /// `look`, even without a notification from PostgreSQL. With SQLite there is no other process.
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

    /// Returns when the connection is lost; notifications are then lost until the next call.
    async fn listen(&self, url: &str, look: Duration) -> Result<Infallible> {
        let mut listener = PgListener::connect(url).await?;
        listener.listen(CHANNEL).await?;
        // The first tick comes at once, to catch changes from before the connection.
        let mut look = interval(look);
        let mut pause = interval(PAUSE);
        pause.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut has_changed = false;
        loop {
            tokio::select! {
                notice = listener.recv() => match notice?.payload() {
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
    /// Wakes all watchers of this job's changes, once the transaction is committed.
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
    async fn a_commit_wakes_its_watchers_and_a_rollback_wakes_none() {
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
    async fn a_commit_of_another_process_wakes_watchers_here() {
        let (_dir, here) = of_a_server().await;
        let url = here.url.clone().expect("PostgreSQL");
        let there = Store::at(&url).await.expect("open");
        let (mut queue, shutdown) = (here.queue(), CancellationToken::new());
        let rarely = Duration::from_secs(600);
        let listening = tokio::spawn(here.keep_listening(rarely, shutdown.clone()));
        // Now it is listening.
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
