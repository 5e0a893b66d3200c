//! State shared by handlers and workers.

pub mod crew;
pub mod readiness;
mod running;

use std::sync::Arc;

use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use self::running::Running;
use crate::config::{Limits, ServeConfig};
use crate::failpoint::Failpoint;
use crate::files::blob_cache::BlobCache;
use crate::files::data::DataDir;
use crate::files::incoming::Uploads;
use crate::files::upload_locks::UploadLocks;
use crate::rate::Rates;
use crate::render::Renderers;
use crate::store::Store;
use crate::telemetry::Telemetry;
use crate::validator::Validators;

/// The state of a server.
#[derive(Debug)]
pub struct App {
    /// The configuration.
    pub config: ServeConfig,
    /// Timeouts and sizes.
    pub limits: Limits,
    /// The data directory.
    pub data: DataDir,
    /// The database.
    pub store: Store,
    /// The local cache of a shared blob store.
    pub blob_cache: BlobCache,
    /// The name of this installation among those that share a database.
    pub worker: String,
    /// Uploads in progress.
    pub uploads: Uploads,
    /// Locks on resumable uploads in use by requests.
    pub upload_locks: UploadLocks,
    /// The processes that validate uploads.
    pub validators: Validators,
    /// The render process.
    pub renderers: Renderers,
    /// Rate limits of clients.
    pub rates: Rates,
    /// Held while a capture is stored whose owner has a quota.
    pub keeping: tokio::sync::Mutex<()>,
    /// Held while frames are extracted from a video.
    pub filming: tokio::sync::Mutex<()>,
    /// Permits for waiting for a mesh, and making it.
    pub mesh_places: Semaphore,
    /// Held while a mesh is made.
    pub meshing: tokio::sync::Mutex<()>,
    /// Permits for generating exports while they are sent.
    pub exporting: Arc<Semaphore>,
    /// Counters for `/metrics`.
    pub telemetry: Telemetry,
    /// Running jobs.
    pub running: Running,
    /// The last result of the readiness checks.
    pub readiness: tokio::sync::Mutex<Option<readiness::Remembered>>,
    /// Raised when the server stops.
    pub shutdown: CancellationToken,
}

impl App {
    /// Assembles a server.
    pub fn new(
        config: ServeConfig,
        data: DataDir,
        store: Store,
        blob_cache: BlobCache,
        worker: String,
    ) -> Self {
        let limits = config.limits;
        Self {
            renderers: Renderers::new(config.render_command.clone(), limits.render, limits.grace),
            uploads: Uploads::default(),
            upload_locks: UploadLocks::default(),
            validators: Validators::new(config.assess_command.clone(), limits),
            config,
            limits,
            data,
            store,
            blob_cache,
            worker,
            readiness: tokio::sync::Mutex::default(),
            shutdown: CancellationToken::new(),
            rates: Rates::new(limits.rate, limits.burst),
            keeping: tokio::sync::Mutex::default(),
            filming: tokio::sync::Mutex::default(),
            mesh_places: Semaphore::new(limits.exports),
            meshing: tokio::sync::Mutex::default(),
            exporting: Arc::new(Semaphore::new(limits.exports)),
            telemetry: Telemetry::default(),
            running: Running::default(),
        }
    }

    /// Returns whether less space is left than the server needs to continue. A file system that
    /// does not report its free space counts as having enough.
    pub fn is_disk_full(&self) -> bool {
        self.has_no_space_for(0)
    }

    /// Returns whether `bytes` more would leave less space than the server needs to continue.
    pub fn has_no_space_for(&self, bytes: u64) -> bool {
        self.data
            .free_bytes()
            .is_ok_and(|free| free < self.limits.min_free_bytes.saturating_add(bytes))
    }

    /// Bytes that may be written before less space is left than the server needs to continue.
    pub fn free_space(&self) -> u64 {
        let free = self.data.free_bytes().unwrap_or(u64::MAX);
        free.saturating_sub(self.limits.min_free_bytes)
    }

    /// Reports a failpoint to the watcher, if there is one.
    pub fn pass(&self, failpoint: Failpoint) {
        if let Some(watcher) = self.config.watcher {
            watcher(failpoint);
        }
    }
}
