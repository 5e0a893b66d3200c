//! Who gives a worker its jobs and hears what becomes of them: the database, or a service that is
//! reached by HTTP and asks its database.

mod errand;
mod remote;
mod wire;

use std::time::Duration;

use fled_blobs::Kept;

use crate::config::Limits;
use crate::error::{Result, ServerError};
use crate::jobs::after_death;
use crate::jobs::state::JobState;
use crate::store::{About, Engine, Lease, Machine, Saying, Settlement, Store};

pub use errand::{Awaited, Errand, Headway, Kind, Outcome, Task, Willing};
pub use remote::Remote;
pub use wire::{
    Assignment, Failures, Files, LEASE_LOST, NamedFile, Present, Pulse, Released, Settled,
    Standing, Told, Under, VERSION, VERSION_HEADER, Wanted, What,
};

/// How often an idle worker looks into a file for retries that have become due and for leases that
/// ran out.
const IDLE: Duration = Duration::from_millis(500);
/// Between two questions of which the service has already waited for the answer.
const PAUSE: Duration = Duration::from_millis(50);
/// A worker that was not heard of for so long is forgotten, milliseconds.
const FORGOTTEN_MS: i64 = 24 * 3600 * 1000;

/// Who gives a worker its jobs.
#[derive(Clone, Debug)]
pub enum Coordinator {
    /// The database, and the times that its leases keep.
    Own(Store, Box<Limits>),
    /// A service.
    Far(Remote),
}

impl Coordinator {
    /// Says that a worker is there, and whether it takes no more jobs.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn see(&self, worker: &str, about: &About, draining: bool) -> Result<()> {
        match self {
            Self::Own(store, _) => see(store, worker, about, draining).await,
            Self::Far(remote) => remote.see(worker, about, draining).await,
        }
    }

    /// Says that a worker goes.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn forget(&self, worker: &str) -> Result<()> {
        match self {
            Self::Own(store, _) => store.forget_workers(Some(worker), 0).await,
            Self::Far(remote) => remote.forget(worker).await,
        }
    }

    /// Jobs whose worker is dead, frozen or cut off wait again, where workers share a database. A
    /// worker of a server that is the only one was stopped with it: its job runs, however long ago
    /// its lease ran out. A service looks by itself.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn release_expired(&self) -> Result<Vec<String>> {
        match self {
            Self::Own(store, limits) if store.engine() == Engine::Postgres => {
                let settle = |deaths| after_death(limits, deaths);
                store.release_expired(&[], settle).await
            }
            Self::Own(..) | Self::Far(_) => Ok(Vec::new()),
        }
    }

    /// Takes a job, but none of `running`, for one of a worker's turns on such a machine.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn claim(
        &self,
        (worker, turn): (&str, u32),
        running: &[String],
        machine: Machine,
    ) -> Result<Option<Assignment>> {
        match self {
            Self::Own(store, limits) => {
                let owner = format!("{worker}/{turn}");
                let lease = milliseconds(limits.lease);
                let claim = store.claim_fit(&owner, lease, running, machine).await?;
                Ok(claim.map(Assignment::from))
            }
            Self::Far(remote) => remote.claim((worker, turn), running, machine).await,
        }
    }

    /// How long a worker that found nothing waits before it looks again by itself.
    pub fn idle(&self, limits: &Limits) -> Duration {
        match self {
            Self::Own(store, _) if store.engine() == Engine::Sqlite => IDLE,
            Self::Own(..) | Self::Far(_) => limits.look,
        }
    }

    /// Extends a lease and says whether somebody asked to stop the job. Asks once.
    ///
    /// # Errors
    /// [`crate::ServerError::LeaseLost`] when another worker has it.
    pub async fn heartbeat(&self, lease: &Lease) -> Result<bool> {
        match self {
            Self::Own(store, limits) => store.heartbeat(lease, milliseconds(limits.lease)).await,
            Self::Far(remote) => Ok(remote.heartbeat(lease).await?.cancel),
        }
    }

    /// Tells one thing, once.
    ///
    /// # Errors
    /// [`crate::ServerError::LeaseLost`] when another worker has the job.
    pub async fn tell(&self, lease: &Lease, saying: Saying<'_>) -> Result<()> {
        match self {
            Self::Own(store, _) => store.say(lease, saying).await,
            Self::Far(remote) => remote.tell(lease, saying).await,
        }
    }

    /// Failures in a row without progress, counting one that happens now.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn count_failure(&self, lease: &Lease) -> Result<u32> {
        match self {
            Self::Own(store, _) => store.count_failure(lease).await,
            Self::Far(remote) => remote.count_failure(lease).await,
        }
    }

    /// Ends an attempt.
    ///
    /// # Errors
    /// [`crate::ServerError::LeaseLost`] when another worker has the job.
    pub async fn settle(&self, lease: &Lease, settlement: &Settlement) -> Result<JobState> {
        match self {
            Self::Own(store, _) => store.settle(lease, settlement).await,
            Self::Far(remote) => remote.settle(lease, settlement).await,
        }
    }

    /// The files of the capture of a job.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn capture_files(&self, job: &Assignment) -> Result<Vec<Kept>> {
        match self {
            Self::Own(store, _) => store.capture_files(&job.capture).await,
            Self::Far(remote) => remote.capture_files(&job.lease).await,
        }
    }

    /// The files of a job and the version of them; `None` where there is no such job.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn job_files(&self, lease: &Lease) -> Result<Option<(i64, Vec<Kept>)>> {
        match self {
            Self::Own(store, _) => store.job_files(&lease.job).await,
            Self::Far(remote) => remote.job_files(lease).await.map(Some),
        }
    }

    /// Takes up what a replica asks of a worker. A service is waited for while it has nothing.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn next_errand(&self, worker: &str, kind: Kind) -> Result<Option<Errand>> {
        match self {
            Self::Own(store, limits) => take_errand(store, limits, worker, kind).await,
            Self::Far(remote) => remote.next_errand(worker, kind).await,
        }
    }

    /// How long a worker that found none waits before it looks again by itself.
    pub fn errand_pause(&self, limits: &Limits) -> Duration {
        match self {
            Self::Own(..) => limits.look,
            Self::Far(_) => PAUSE,
        }
    }

    /// A worker still does it; whether somebody still waits for it. Asks once.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn extend_errand(&self, worker: &str, id: &str, headway: Headway) -> Result<bool> {
        match self {
            Self::Own(store, limits) => {
                let (headway, life) = ((headway.done, headway.total), milliseconds(limits.errand));
                store.extend_errand(id, worker, headway, life).await
            }
            Self::Far(remote) => remote.extend_errand(worker, id, headway).await,
        }
    }

    /// Says what came of it.
    ///
    /// # Errors
    /// When the database or the service refuses.
    pub async fn answer_errand(&self, worker: &str, id: &str, outcome: &Outcome) -> Result<()> {
        match self {
            Self::Own(store, _) => answer_errand(store, worker, id, outcome).await.map(drop),
            Self::Far(remote) => remote.answer_errand(worker, id, outcome).await,
        }
    }

    /// Ends what is held open.
    pub async fn close(&self) {
        if let Self::Own(store, _) = self {
            store.close().await;
        }
    }
}

/// Notes that a worker is there, and forgets those that have not been for long.
///
/// # Errors
/// When the database refuses.
pub async fn see(store: &Store, worker: &str, about: &About, draining: bool) -> Result<()> {
    store.see_worker(worker, about, draining).await?;
    let before = store.now().await? - FORGOTTEN_MS;
    store.forget_workers(None, before).await
}

/// Takes up what a worker is asked for, out of the database.
///
/// # Errors
/// When the database refuses, or holds what nobody understands.
pub async fn take_errand(
    store: &Store,
    limits: &Limits,
    worker: &str,
    kind: Kind,
) -> Result<Option<Errand>> {
    let life = milliseconds(limits.errand);
    let taken = store.take_errand((worker, kind.name()), life).await?;
    let errand = taken.map(|(_, errand)| serde_json::from_str(&errand));
    errand.transpose().map_err(|error| damaged(&error))
}

/// Says in the database what came of it; whether somebody waits for it.
///
/// # Errors
/// When the database refuses.
pub async fn answer_errand(
    store: &Store,
    worker: &str,
    id: &str,
    outcome: &Outcome,
) -> Result<bool> {
    let told = serde_json::to_string(outcome).map_err(|error| damaged(&error))?;
    store.answer_errand(id, worker, &told).await
}

fn damaged(error: &serde_json::Error) -> ServerError {
    ServerError::Damaged {
        what: "errand",
        detail: error.to_string(),
    }
}

/// As databases count.
pub fn milliseconds(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).unwrap_or(i64::MAX)
}
