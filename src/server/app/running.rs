//! The jobs that this server's workers run.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::store::Lease;

/// The notifier that stops each running job, and the epoch under which it runs.
#[derive(Debug, Default)]
pub struct Running {
    jobs: Mutex<HashMap<String, (i64, Arc<Notify>)>>,
    claiming: tokio::sync::Mutex<()>,
}

impl Running {
    /// The right to claim a job. Held until the job is listed as running: if the server were
    /// suspended in between for longer than a lease, another worker would claim the job as well.
    pub async fn claiming(&self) -> tokio::sync::MutexGuard<'_, ()> {
        self.claiming.lock().await
    }

    /// Records that the job runs under this lease, and returns the notifier that stops it. A lease
    /// that another worker has taken over meanwhile is not recorded.
    pub fn begin(&self, lease: &Lease) -> Arc<Notify> {
        let notifier = Arc::new(Notify::new());
        let mut jobs = self.lock();
        let known = jobs.get(&lease.job);
        if known.is_none_or(|&(epoch, _)| epoch < lease.epoch) {
            jobs.insert(lease.job.clone(), (lease.epoch, notifier.clone()));
        }
        notifier
    }

    /// Removes the entry of a job that no longer runs under this lease. If another worker has taken
    /// the job over, its entry stays.
    pub fn end(&self, lease: &Lease) {
        let mut jobs = self.lock();
        if jobs.get(&lease.job).is_some_and(|&(epoch, _)| epoch == lease.epoch) {
            jobs.remove(&lease.job);
        }
    }

    /// Stops the job's process if a worker of this server runs it.
    pub fn stop(&self, job: &str) {
        if let Some((_, notifier)) = self.lock().get(job) {
            // The notifier keeps the signal until it is awaited, so no order of events loses it.
            notifier.notify_one();
        }
    }

    /// Whether the job runs here.
    pub fn has(&self, job: &str) -> bool {
        self.lock().contains_key(job)
    }

    /// The running jobs.
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
    async fn a_worker_that_lost_a_job_keeps_the_entry_of_its_successor() {
        let lease = |epoch| Lease { job: "j".to_owned(), epoch };
        let running = Running::default();
        running.begin(&lease(1));
        let notifier = running.begin(&lease(2));
        // Late: the worker was suspended between its claim and this call.
        running.begin(&lease(1));
        running.end(&lease(1));
        assert_eq!(running.jobs(), ["j"]);
        running.stop("j");
        notifier.notified().await;
        running.end(&lease(2));
        assert!(running.jobs().is_empty());
    }
}
