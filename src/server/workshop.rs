//! What a worker needs for its jobs, whether it has the database or a service that has one.

use std::sync::Arc;

use tokio::sync::{Notify, watch};
use tokio_util::sync::CancellationToken;

use crate::config::{Limits, ServeConfig};
use crate::coordinator::Coordinator;
use crate::data::DataDir;
use crate::errands::bells::Bells;
use crate::mirror::Mirror;
use crate::point::Point;
use crate::render::Renderers;
use crate::running::Running;
use crate::traces::Traces;

/// What a worker needs for its jobs. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Workshop {
    /// The set-up.
    pub config: Arc<ServeConfig>,
    /// Times and sizes.
    pub limits: Limits,
    /// The files.
    pub data: Arc<DataDir>,
    /// Who gives it jobs.
    pub coordinator: Coordinator,
    /// Copies of what many machines share.
    pub mirror: Arc<Mirror>,
    /// What renders views here.
    pub renderers: Arc<Renderers>,
    /// Rung when somebody asks for something.
    pub bells: Arc<Bells>,
    /// What this installation is called among the workers.
    pub worker: Arc<str>,
    /// The jobs that run.
    pub running: Arc<Running>,
    /// Rung when a job may be waiting.
    pub wake: Arc<Notify>,
    /// Raised when the process stops.
    pub shutdown: CancellationToken,
    /// Whom it tells what it does, and when.
    pub traces: Traces,
    /// Who looks at jobs here.
    pub lookers: Lookers,
}

impl Workshop {
    /// Whether less space is left than is needed to go on. A file system that does not say is taken
    /// to have enough.
    pub fn is_disk_full(&self) -> bool {
        let free = self.data.free_bytes();
        free.is_ok_and(|free| free < self.limits.min_free_bytes)
    }

    /// Says what a worker has just done.
    pub fn pass(&self, point: Point) {
        if let Some(watcher) = self.config.watcher {
            watcher(point);
        }
    }

    /// Tells all who look at jobs here to look again.
    pub fn changed(&self) {
        self.lookers.call();
    }
}

/// Those who look again when something has changed, such as event streams. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Lookers(watch::Sender<u64>);

impl Lookers {
    /// Calls all of them.
    pub fn call(&self) {
        self.0.send_modify(|version| *version += 1);
    }

    /// Sees every call from now on.
    pub fn join(&self) -> watch::Receiver<u64> {
        self.0.subscribe()
    }
}

impl Default for Lookers {
    fn default() -> Self {
        Self(watch::Sender::new(0))
    }
}
