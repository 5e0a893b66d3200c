//! The jobs that workers of this server run.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::store::Lease;

/// The notifier that stops each running job, and under which epoch it runs.
#[derive(Debug, Default)]
pub struct Running {
    jobs: Mutex<HashMap<String, (i64, Arc<Notify>)>>,
    claiming: tokio::sync::Mutex<()>,
}

impl Running {
    /// The right to claim a job. Held until it is among the running ones: were the server stopped
    /// for longer than a lease between the two, another worker would claim it as well.
    pub async fn claiming(&self) -> tokio::sync::MutexGuard<'_, ()> {
        self.claiming.lock().await
    }

    /// Remembers that the job runs under this lease, and returns the notifier that stops it. A
    /// lease that another worker has taken over meanwhile is not remembered.
    pub fn begin(&self, lease: &Lease) -> Arc<Notify> {
        let notifier = Arc::new(Notify::new());
        let mut jobs = self.lock();
        let known = jobs.get(&lease.job);
        if known.is_none_or(|&(epoch, _)| epoch < lease.epoch) {
            jobs.insert(lease.job.clone(), (lease.epoch, notifier.clone()));
        }
        notifier
    }

    /// Forgets a job that no longer runs under this lease. Another worker that has taken it over
    /// keeps its own entry.
    pub fn end(&self, lease: &Lease) {
        let mut jobs = self.lock();
        if jobs.get(&lease.job).is_some_and(|&(epoch, _)| epoch == lease.epoch) {
            jobs.remove(&lease.job);
        }
    }

    /// Stops the job's process, when a worker of this server runs it.
    pub fn stop(&self, job: &str) {
        if let Some((_, notifier)) = self.lock().get(job) {
            // Remembered until it is awaited, so that no order of events loses it.
            notifier.notify_one();
        }
    }

    /// Whether the job runs here.
    pub fn has(&self, job: &str) -> bool {
        self.lock().contains_key(job)
    }

    /// The jobs that run.
    pub fn jobs(&self) -> Vec<String> {
        self.lock().keys().cloned().collect()
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, (i64, Arc<Notify>)>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn who_lost_a_job_does_not_forget_it_for_who_has_it_now() {
        let lease = |epoch| Lease { job: "j".to_owned(), epoch };
        let running = Running::default();
        running.begin(&lease(1));
        let notifier = running.begin(&lease(2));
        // Late: it was stopped between its claim and this.
        running.begin(&lease(1));
        running.end(&lease(1));
        assert_eq!(running.jobs(), ["j"]);
        running.stop("j");
        notifier.notified().await;
        running.end(&lease(2));
        assert!(running.jobs().is_empty());
    }
}
