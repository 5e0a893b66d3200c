//! What handlers and workers share.

use std::sync::Arc;

use tokio::sync::{Notify, Semaphore, watch};
use tokio_util::sync::CancellationToken;

use crate::assessor::Assessors;
use crate::config::{Limits, ServeConfig};
use crate::coordinator::Coordinator;
use crate::data::DataDir;
use crate::errands::bells::Bells;
use crate::errands::unwilling::Unwilling;
use crate::holders::Holders;
use crate::incoming::Uploads;
use crate::mirror::Mirror;
use crate::rate::Rates;
use crate::render::{self, Renderers};
use crate::running::Running;
use crate::store::Store;
use crate::tails::Tails;
use crate::telemetry::Telemetry;
use crate::traces::Traces;
use crate::videos::turns::Turns;
use crate::workshop::{Lookers, Workshop};

/// The state of a server.
#[derive(Debug)]
pub struct App {
    /// The set-up.
    pub config: Arc<ServeConfig>,
    /// Times and sizes.
    pub limits: Limits,
    /// The files.
    pub data: Arc<DataDir>,
    /// The database.
    pub store: Store,
    /// Copies of what many machines share.
    pub mirror: Arc<Mirror>,
    /// What this installation is called among those that share a database.
    pub worker: Arc<str>,
    /// The uploads that are under way.
    pub uploads: Uploads,
    /// Who writes or reads which upload in pieces.
    pub holders: Holders,
    /// The processes that look at uploads.
    pub assessors: Assessors,
    /// The render process.
    pub renderers: Arc<Renderers>,
    /// Rung when somebody asks for something, or answers.
    pub bells: Arc<Bells>,
    /// Workers that did not do what they were asked.
    pub unwilling: Unwilling,
    /// Turns at asking workers for views.
    pub asking: render::turns::Turns,
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
    /// Turns at fetching captures.
    pub fetching: Arc<Semaphore>,
    /// What it counts about itself.
    pub telemetry: Telemetry,
    /// The newest events of jobs that are watched.
    pub tails: Tails,
    /// Whom it tells what it does, and when.
    pub traces: Traces,
    /// The jobs that run.
    pub running: Arc<Running>,
    /// The last judgement of the machine.
    pub readiness: tokio::sync::Mutex<Option<crate::readiness::Remembered>>,
    /// Rung when a job may be waiting.
    pub wake: Arc<Notify>,
    /// Raised when the server stops.
    pub shutdown: CancellationToken,
    lookers: Lookers,
}

/// Views that are asked of workers at a time; with those who wait for it.
const ASKED_AT_ONCE: usize = 8;
/// More are refused.
const MOST_ASKED: usize = 64;

impl App {
    /// Puts a server's parts together.
    pub fn new(
        config: ServeConfig,
        data: DataDir,
        store: Store,
        mirror: Mirror,
        worker: String,
        traces: Traces,
    ) -> Self {
        let limits = config.limits;
        Self {
            renderers: Renderers::of(&config).into(),
            bells: Arc::default(),
            unwilling: Unwilling::default(),
            asking: render::turns::Turns::new(MOST_ASKED, ASKED_AT_ONCE),
            uploads: Uploads::default(),
            holders: Holders::default(),
            assessors: Assessors::new(config.assess_command.clone(), limits),
            config: Arc::new(config),
            limits,
            data: Arc::new(data),
            store,
            mirror: Arc::new(mirror),
            worker: worker.into(),
            readiness: tokio::sync::Mutex::default(),
            wake: Arc::default(),
            shutdown: CancellationToken::new(),
            lookers: Lookers::default(),
            rates: Rates::new(limits.rate, limits.burst),
            keeping: tokio::sync::Mutex::default(),
            filming: tokio::sync::Mutex::default(),
            videos: Turns::default(),
            exporting: Arc::new(Semaphore::new(limits.exports)),
            fetching: Arc::new(Semaphore::new(limits.fetching)),
            telemetry: Telemetry::default(),
            tails: Tails::default(),
            traces,
            running: Arc::default(),
        }
    }

    /// What its workers need of it.
    pub fn workshop(&self) -> Workshop {
        Workshop {
            config: self.config.clone(),
            limits: self.limits,
            data: self.data.clone(),
            coordinator: Coordinator::Own(self.store.clone(), Box::new(self.limits)),
            mirror: self.mirror.clone(),
            renderers: self.renderers.clone(),
            bells: self.bells.clone(),
            worker: self.worker.clone(),
            running: self.running.clone(),
            wake: self.wake.clone(),
            shutdown: self.shutdown.clone(),
            lookers: self.lookers.clone(),
            traces: self.traces.clone(),
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

    /// Tells every open event stream to look into the database.
    pub fn changed(&self) {
        self.lookers.call();
    }

    /// Sees every [`App::changed`] from now on.
    pub fn watch(&self) -> watch::Receiver<u64> {
        self.lookers.join()
    }
}
