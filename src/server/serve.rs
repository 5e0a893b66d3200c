//! The life cycle of a server: open, recover, serve, stop.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use fled_blobs::Blobs;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio::task::JoinSet;

use crate::app::App;
use crate::config::ServeConfig;
use crate::error::{Result, ServerError};
use crate::files::blob_cache::BlobCache;
use crate::files::data::DataDir;
use crate::http::{router, serve_connections};
use crate::janitor;
use crate::memory;
use crate::sharing::fetch_job;
use crate::store::{Engine, JobKind, Store};
use crate::transfer::adopt_videos;
use crate::webhooks::keep_telling;
use crate::worker::log::LogWriter;
use crate::worker::{self, after_death, kill_orphans};

/// How long open requests may take to finish once the server stops.
const FAREWELL: Duration = Duration::from_secs(5);
/// How long this process's jobs may take to save and publish their state when it stops: supervisors
/// usually wait half a minute.
const HANDING_IN: Duration = Duration::from_secs(25);

/// A running server.
#[derive(Debug)]
pub struct Server {
    /// `None` for a worker without an API.
    address: Option<SocketAddr>,
    app: Arc<App>,
    /// The tasks that run jobs.
    turns: JoinSet<()>,
    /// All other tasks.
    tasks: JoinSet<()>,
}

impl Server {
    /// Opens the data directory, recovers the jobs of an earlier server, listens and works.
    ///
    /// # Errors
    /// When the directory is in use or unusable, or the address is taken.
    pub async fn start(config: ServeConfig) -> Result<Self> {
        let opened = open(&config).await?;
        guard(&config, &opened.store).await?;
        let name = config.listen.to_string();
        let listener =
            TcpListener::bind(config.listen).await.map_err(ServerError::io(Path::new(&name)))?;
        let address = listener.local_addr().map_err(ServerError::io(Path::new(&name)))?;
        let app = opened.app(config, true).await;
        for job in app.store.jobs_with_video_files().await? {
            fetch_job(&app, &job).await?;
        }
        adopt_videos(&app.store, &app.data).await?;
        let mut tasks = JoinSet::new();
        tasks.spawn(keep_telling(app.clone()));
        let turns = spawn_shared(&app, &mut tasks, true);
        let (limits, shutdown) = (app.limits, app.shutdown.clone());
        tasks.spawn(serve_connections(listener, router(app.clone()), limits, shutdown));
        Ok(Self { address: Some(address), app, turns, tasks })
    }

    /// Opens the data directory and the database and runs jobs, without an API.
    ///
    /// # Errors
    /// When one of them is in use or unusable.
    pub async fn start_worker(config: ServeConfig) -> Result<Self> {
        let mut tasks = JoinSet::new();
        let app = open(&config).await?.app(config, false).await;
        let turns = spawn_shared(&app, &mut tasks, false);
        Ok(Self { address: None, app, turns, tasks })
    }

    /// The address it listens on, if any.
    pub fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// Stops: running jobs are interrupted and queued again, and open requests may finish.
    pub async fn stop(mut self) {
        let app = &self.app;
        app.shutdown.cancel();
        let jobs = end(&mut self.turns, HANDING_IN, "jobs");
        let requests = end(&mut self.tasks, FAREWELL, "requests");
        tokio::join!(jobs, requests);
        // Renders are not waited for: their process ends with this one.
        let grace = app.limits.grace;
        if tokio::time::timeout(grace, app.renderers.stop()).await.is_err() {
            tracing::info!("a picture was still being rendered");
        }
        if app.config.about.is_some()
            && let Err(error) = app.store.forget_workers(Some(&app.worker), 0).await
        {
            tracing::warn!(%error, "other machines will consider this worker lost for a while");
        }
        app.store.close().await;
    }
}

/// The resources that a process opens before it works.
struct Opened {
    data: DataDir,
    store: Store,
    blob_cache: BlobCache,
    worker: String,
}

/// Opens what the configuration names, and recovers what an earlier process has left here.
async fn open(config: &ServeConfig) -> Result<Opened> {
    let data = DataDir::open(&config.data)?;
    let store = match &config.database {
        Some(url) => Store::at(url).await?,
        None => Store::open(&data.database()).await?,
    };
    let blobs = match &config.files {
        Some(place) => {
            let blobs = Blobs::open(place)?;
            blobs.check().await?;
            tracing::info!(store = blobs.location(), "files are shared");
            Some(blobs)
        }
        None if store.engine() == Engine::Postgres => return Err(ServerError::NoFiles),
        None => None,
    };
    if let Some(blobs) = &blobs {
        // Otherwise the files here would be mistaken for an outdated cache and removed.
        if let Some(capture) = store.capture_without_files().await? {
            return Err(ServerError::NotInStore(capture));
        }
        janitor::claim(&store, blobs).await?;
    }
    let worker = data.worker()?;
    let limits = config.limits;
    let ran_out = memory::ran_out_since(&data.oom_kills());
    let settle = |deaths| after_death(&limits, deaths, ran_out);
    let left = match store.engine() {
        // No other process uses the database.
        Engine::Sqlite => store.release_all(settle).await?,
        Engine::Postgres => store.release_of(&worker, settle).await?,
    };
    if !left.is_empty() {
        let orphans = kill_orphans(&left);
        tracing::info!(jobs = left.len(), orphans, "continuing jobs of an earlier server");
        for job in &left {
            log_restart(&data.log(job), config);
        }
    }
    Ok(Opened { data, store, blob_cache: BlobCache::new(blobs), worker })
}

/// Says in a job's log why its last attempt has no end. A log that cannot be written stops no job.
fn log_restart(log: &Path, config: &ServeConfig) {
    match LogWriter::open(log, config.limits.max_log_bytes) {
        Ok(mut log) => log.line("continued after a restart of the server"),
        Err(error) => tracing::warn!(%error, "cannot write a job's log"),
    }
}

impl Opened {
    async fn app(self, config: ServeConfig, serves: bool) -> Arc<App> {
        let (data, store, blob_cache) = (self.data, self.store, self.blob_cache);
        let app = Arc::new(App::new(config, data, store, blob_cache, self.worker));
        janitor::clean(app.clone(), serves, Duration::ZERO).await;
        app
    }
}

/// Waits for tasks to end, and aborts those that take too long.
async fn end(tasks: &mut JoinSet<()>, patience: Duration, what: &str) {
    let ended = async { while tasks.join_next().await.is_some() {} };
    if tokio::time::timeout(patience, ended).await.is_err() {
        tracing::warn!("{what} were still open");
    }
    tasks.shutdown().await;
}

/// Starts the tasks common to all processes: register with the others, run the configured number of
/// jobs at a time, and make one video at a time, which yields to the jobs.
fn spawn_shared(app: &Arc<App>, tasks: &mut JoinSet<()>, serves: bool) -> JoinSet<()> {
    tasks.spawn(janitor::keep_clean(app.clone(), serves));
    let (look, shutdown) = (app.limits.look, app.shutdown.clone());
    tasks.spawn(app.store.clone().keep_listening(look, shutdown));
    if app.config.about.is_some() {
        tasks.spawn(worker::keep_registered(app.clone()));
    }
    let mut turns = JoinSet::new();
    for turn in 0..u32::try_from(app.config.workers).unwrap_or(u32::MAX) {
        turns.spawn(worker::work(app.clone(), JobKind::Scene, turn.to_string()));
    }
    turns.spawn(worker::work(app.clone(), JobKind::Video, "video".to_owned()));
    turns
}

/// Logs who may use the server.
///
/// # Errors
/// [`ServerError::Unguarded`] if anyone could without a token.
async fn guard(config: &ServeConfig, store: &Store) -> Result<()> {
    if store.has_tokens().await? {
        tracing::info!("every request requires a token");
    } else if config.listen.ip().to_canonical().is_loopback() {
        tracing::info!("there is no token: anyone on this machine may do everything");
    } else if config.open {
        tracing::warn!("there is no token: anyone who can reach this server may do everything");
    } else {
        return Err(ServerError::Unguarded(config.listen));
    }
    Ok(())
}

/// Serves until SIGINT or SIGTERM.
///
/// # Errors
/// When the server cannot start.
pub async fn serve(config: ServeConfig) -> Result<()> {
    let server = Server::start(config).await?;
    if let Some(address) = server.address() {
        tracing::info!("listening on http://{address}");
    }
    until_signalled(server).await
}

/// Runs jobs until SIGINT or SIGTERM; running jobs are then queued again.
///
/// # Errors
/// When the worker cannot start.
pub async fn work(config: ServeConfig) -> Result<()> {
    let server = Server::start_worker(config).await?;
    tracing::info!(worker = server.app.worker, "working");
    until_signalled(server).await
}

/// Waits for a signal, then stops.
async fn until_signalled(server: Server) -> Result<()> {
    let io = |source| ServerError::Io { path: "signals".into(), source };
    let mut interrupt = signal(SignalKind::interrupt()).map_err(io)?;
    let mut terminate = signal(SignalKind::terminate()).map_err(io)?;
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
    tracing::info!("stopping");
    server.stop().await;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::keep_capture;
    use crate::store::{NewToken, Quotas};
    use crate::token::Secret;

    #[tokio::test]
    async fn a_directory_with_its_own_files_is_not_taken_for_a_cache() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let store = Store::open(&dir.path().join("fled.db")).await.expect("open");
        keep_capture(&store, "c", None, &[]).await;
        store.close().await;
        let listen = ([127, 0, 0, 1], 0).into();
        let mut config = ServeConfig::new(dir.path().into(), listen, 0).expect("a program");
        config.files = Some(dir.path().join("store").display().to_string());
        let refused = Server::start(config.clone()).await;
        assert!(matches!(&refused, Err(ServerError::NotInStore(id)) if id == "c"), "{refused:?}");
        config.files = None;
        let server = Server::start(config).await.expect("as it was");
        server.stop().await;
    }

    #[tokio::test]
    async fn a_blob_store_serves_only_its_first_database() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let store = dir.path().join("store");
        let config = |name: &str| {
            let listen = ([127, 0, 0, 1], 0).into();
            let config = ServeConfig::new(dir.path().join(name), listen, 0);
            let mut config = config.expect("a program");
            config.files = Some(store.display().to_string());
            config
        };
        for _ in 0..2 {
            let first = Server::start(config("first")).await.expect("its own");
            let refused = [
                Server::start(config("second")).await,
                Server::start_worker(config("second")).await,
            ];
            for refused in refused {
                let refused = refused.map(drop).expect_err("another database");
                assert!(matches!(refused, ServerError::StoreOfAnother(_)));
                let words = refused.to_string();
                assert!(words.contains("--store") && words.contains("delete the object `mark`"));
            }
            first.stop().await;
        }
        // As the message advises when one database replaces the other.
        std::fs::remove_file(store.join("mark")).expect("there was one");
        let second = Server::start(config("second")).await.expect("its own now");
        second.stop().await;
        let refused = Server::start(config("first")).await;
        assert!(matches!(refused, Err(ServerError::StoreOfAnother(_))), "{refused:?}");
    }

    #[tokio::test]
    async fn remote_access_needs_a_token_or_the_open_option() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let start = async |listen: &str, open: bool| {
            let listen = listen.parse().expect("an address");
            let mut config = ServeConfig::new(dir.path().into(), listen, 0).expect("a program");
            config.open = open;
            let server = Server::start(config).await;
            match server {
                Ok(server) => {
                    server.stop().await;
                    Ok(())
                }
                Err(error) => Err(error),
            }
        };
        for own in ["127.0.0.1:0", "127.0.0.2:0"] {
            start(own, false).await.expect("its own machine");
        }
        for reachable in ["0.0.0.0:0", "[::]:0"] {
            let refused = start(reachable, false).await;
            assert!(matches!(refused, Err(ServerError::Unguarded(_))), "{refused:?}");
        }
        start("0.0.0.0:0", true).await.expect("on purpose");
        let store = Store::open(&dir.path().join("fled.db")).await.expect("open");
        let token = NewToken {
            id: "1".to_owned(),
            name: String::new(),
            digest: Secret::new().expect("random").digest(),
            scopes: "admin".parse().expect("scopes"),
            expires_at: None,
            quotas: Quotas::default(),
        };
        store.insert_token(&token).await.expect("kept");
        store.close().await;
        start("0.0.0.0:0", false).await.expect("who has a token");
    }
}
