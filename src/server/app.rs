//! What handlers and workers share.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use fled_core::capture::DecodeBudget;
use tokio::sync::{Notify, watch};
use tokio_util::sync::CancellationToken;

use crate::config::{Limits, ServeConfig};
use crate::data::DataDir;
use crate::incoming::Uploads;
use crate::render::Renderers;
use crate::store::Store;

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
    /// The uploads that are under way.
    pub uploads: Uploads,
    /// What all uploads together may take while they are looked at.
    pub decoding: Arc<DecodeBudget>,
    /// The render process.
    pub renderers: Renderers,
    /// The last judgement of the machine.
    pub readiness: tokio::sync::Mutex<Option<crate::readiness::Remembered>>,
    /// Rung when a job may be waiting.
    pub wake: Notify,
    /// Raised when the server stops.
    pub shutdown: CancellationToken,
    versions: watch::Sender<u64>,
    running: Mutex<HashMap<String, Arc<Notify>>>,
}

impl App {
    /// Puts a server's parts together.
    pub fn new(config: ServeConfig, data: DataDir, store: Store) -> Self {
        let limits = config.limits;
        Self {
            renderers: Renderers::new(config.render_command.clone(), limits.render, limits.grace),
            uploads: Uploads::default(),
            decoding: Arc::new(DecodeBudget::new(limits.max_decoding_bytes)),
            config,
            limits,
            data,
            store,
            readiness: tokio::sync::Mutex::default(),
            wake: Notify::new(),
            shutdown: CancellationToken::new(),
            versions: watch::Sender::new(0),
            running: Mutex::default(),
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

    /// Tells every open event stream to look into the database.
    pub fn changed(&self) {
        self.versions.send_modify(|version| *version += 1);
    }

    /// Sees every [`App::changed`] from now on.
    pub fn watch(&self) -> watch::Receiver<u64> {
        self.versions.subscribe()
    }

    /// Remembers that a worker of this server runs the job; what rings to stop it.
    pub fn begin(&self, job: &str) -> Arc<Notify> {
        let bell = Arc::new(Notify::new());
        self.running
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(job.to_owned(), bell.clone());
        bell
    }

    /// Forgets a job that no longer runs.
    pub fn end(&self, job: &str) {
        self.running
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .remove(job);
    }

    /// Stops the job's process, when a worker of this server runs it.
    pub fn stop(&self, job: &str) {
        if let Some(bell) = self
            .running
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get(job)
        {
            // Remembered until it is awaited, so that no order of events loses it.
            bell.notify_one();
        }
    }
}
