//! What handlers and workers share.

use std::sync::Arc;

use tokio::sync::{Notify, Semaphore, watch};
use tokio_util::sync::CancellationToken;

use crate::blob_cache::BlobCache;
use crate::config::{Limits, ServeConfig};
use crate::data::DataDir;
use crate::event_feed::EventFeeds;
use crate::failpoint::Failpoint;
use crate::holders::Holders;
use crate::incoming::Uploads;
use crate::rate::Rates;
use crate::render::Renderers;
use crate::running::Running;
use crate::store::Store;
use crate::telemetry::Telemetry;
use crate::validator::Validators;
use crate::videos::turns::Turns;

/// The state of a server.
#[derive(Debug)]
pub struct App {
    /// The set-up.
    pub config: ServeConfig,
    /// Times and sizes.
    pub limits: Limits,
    /// The files.
    pub data: DataDir,
    /// The database.
    pub store: Store,
    /// Copies of what many machines share.
    pub blob_cache: BlobCache,
    /// What this installation is called among those that share a database.
    pub worker: String,
    /// The uploads that are under way.
    pub uploads: Uploads,
    /// Who writes or reads which upload in pieces.
    pub holders: Holders,
    /// The processes that look at uploads.
    pub validators: Validators,
    /// The render process.
    pub renderers: Renderers,
    /// What each client may ask for.
    pub rates: Rates,
    /// Held while a capture is kept whose owner has a quota.
    pub keeping: tokio::sync::Mutex<()>,
    /// Held while photographs are taken of a video.
    pub filming: tokio::sync::Mutex<()>,
    /// The videos that wait or are made.
    pub videos: Turns,
    /// Turns at making exports.
    pub exporting: Arc<Semaphore>,
    /// What it counts about itself.
    pub telemetry: Telemetry,
    /// The newest events of jobs that are watched.
    pub feeds: EventFeeds,
    /// The jobs that run.
    pub running: Running,
    /// The last judgement of the machine.
    pub readiness: tokio::sync::Mutex<Option<crate::readiness::Remembered>>,
    /// Notified when a job may be waiting.
    pub wake: Notify,
    /// Raised when the server stops.
    pub shutdown: CancellationToken,
    versions: watch::Sender<u64>,
}

impl App {
    /// Puts a server's parts together.
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
            holders: Holders::default(),
            validators: Validators::new(config.assess_command.clone(), limits),
            config,
            limits,
            data,
            store,
            blob_cache,
            worker,
            readiness: tokio::sync::Mutex::default(),
            wake: Notify::new(),
            shutdown: CancellationToken::new(),
            versions: watch::Sender::new(0),
            rates: Rates::new(limits.rate, limits.burst),
            keeping: tokio::sync::Mutex::default(),
            filming: tokio::sync::Mutex::default(),
            videos: Turns::default(),
            exporting: Arc::new(Semaphore::new(limits.exports)),
            telemetry: Telemetry::default(),
            feeds: EventFeeds::default(),
            running: Running::default(),
        }
    }

    /// Whether less space is left than the server needs to go on. A file system that does not say
    /// is taken to have enough.
    pub fn is_disk_full(&self) -> bool {
        self.has_no_space_for(0)
    }

    /// Whether so many bytes more would leave less space than the server needs to go on.
    pub fn has_no_space_for(&self, bytes: u64) -> bool {
        self.data
            .free_bytes()
            .is_ok_and(|free| free < self.limits.min_free_bytes.saturating_add(bytes))
    }

    /// Bytes that may be written before less space is left than the server needs to go on.
    pub fn free_space(&self) -> u64 {
        let free = self.data.free_bytes().unwrap_or(u64::MAX);
        free.saturating_sub(self.limits.min_free_bytes)
    }

    /// Says what a worker has just done.
    pub fn pass(&self, failpoint: Failpoint) {
        if let Some(watcher) = self.config.watcher {
            watcher(failpoint);
        }
    }

    /// Tells every open event stream to look into the database.
    pub fn changed(&self) {
        self.versions.send_modify(|version| *version += 1);
    }

    /// Sees every [`App::changed`] from now on.
    pub fn watch(&self) -> watch::Receiver<u64> {
        self.versions.subscribe()
    }
}
