//! The life of a server: open, recover, serve, stop.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use fled_core::pipeline::error::ErrorKind;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio::task::JoinSet;

use crate::app::App;
use crate::config::{Limits, ServeConfig};
use crate::data::DataDir;
use crate::error::{Result, ServerError};
use crate::expiry::expire;
use crate::http::{router, serve_connections};
use crate::jobs::{kill_orphans, worker};
use crate::store::{JobError, Settlement, Store};
use crate::sweep;
use crate::videos::maker::{keep_making, take_up};
use crate::webhooks::keep_telling;

/// Open requests get so long to end once the server stops.
const FAREWELL: Duration = Duration::from_secs(5);

/// A running server.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    app: Arc<App>,
    tasks: JoinSet<()>,
}

impl Server {
    /// Opens the data directory, takes up what an earlier server has left, listens and works.
    ///
    /// # Errors
    /// When the directory is in use or unusable, or the address is taken.
    pub async fn start(config: ServeConfig) -> Result<Self> {
        let data = DataDir::open(&config.data)?;
        let store = Store::open(&data.database()).await?;
        guard(&config, &store).await?;
        let limits = config.limits;
        let left = store
            .release_all(|deaths| after_death(&limits, deaths))
            .await?;
        if !left.is_empty() {
            let orphans = kill_orphans(&left);
            tracing::info!(
                jobs = left.len(),
                orphans,
                "jobs of an earlier server go on"
            );
        }
        let name = config.listen.to_string();
        let listener = TcpListener::bind(config.listen)
            .await
            .map_err(ServerError::io(Path::new(&name)))?;
        let address = listener
            .local_addr()
            .map_err(ServerError::io(Path::new(&name)))?;
        let workers = config.workers;
        let app = Arc::new(App::new(config, data, store));
        // Before there are workers and requests: what has no row now will never have one.
        let swept = sweep::sweep(&app, Duration::ZERO).await?;
        if swept > 0 {
            tracing::info!(swept, "leftovers of an earlier server are out of the way");
        }
        // A disk that is too full to be written must not keep the server from starting.
        if let Err(error) = expire(&app).await {
            tracing::warn!(%error, "cannot delete what is kept no longer");
        }
        take_up(&app).await?;
        let mut tasks = JoinSet::new();
        tasks.spawn(sweep::keep_sweeping(app.clone()));
        tasks.spawn(keep_telling(app.clone()));
        tasks.spawn(keep_making(app.clone()));
        for index in 0..workers {
            tasks.spawn(worker::work(app.clone(), index));
        }
        let (limits, shutdown) = (app.limits, app.shutdown.clone());
        tasks.spawn(serve_connections(
            listener,
            router(app.clone()),
            limits,
            shutdown,
        ));
        Ok(Self {
            address,
            app,
            tasks,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Stops: running jobs are interrupted and go back to the queue, open requests may end.
    pub async fn stop(mut self) {
        self.app.shutdown.cancel();
        let ended = async { while self.tasks.join_next().await.is_some() {} };
        if tokio::time::timeout(FAREWELL, ended).await.is_err() {
            tracing::warn!("requests were still open");
        }
        self.tasks.shutdown().await;
        self.app.renderers.stop().await;
        self.app.store.close().await;
    }
}

/// Tells who may use the server.
///
/// # Errors
/// [`ServerError::Unguarded`] where that would be everybody, unasked.
async fn guard(config: &ServeConfig, store: &Store) -> Result<()> {
    if store.has_tokens().await? {
        tracing::info!("everything needs a token");
    } else if config.listen.ip().to_canonical().is_loopback() {
        tracing::info!("there is no token: whoever uses this machine may do everything");
    } else if config.open {
        tracing::warn!("there is no token: whoever reaches this server may do everything");
    } else {
        return Err(ServerError::Unguarded(config.listen));
    }
    Ok(())
}

/// What becomes of a job whose server has died so many times in a row without its progress. Memory
/// that runs out takes the server as well as the job: such a job must not start for ever.
fn after_death(limits: &Limits, deaths: u32) -> Settlement {
    let again = deaths < limits.deaths_without_progress;
    // At once after the first, as after a restart by hand.
    let wait = match deaths {
        0 | 1 => 0,
        _ => limits.retry_wait_ms(ErrorKind::Internal, deaths - 1),
    };
    Settlement::Failed {
        error: JobError {
            code: ErrorKind::Internal.name().to_owned(),
            detail: format!("the server died while this job ran, {deaths} times without progress"),
            hint: "Memory may have run out: try a smaller `size` or `cap`, or another machine."
                .to_owned(),
        },
        retry_in_ms: again.then_some(wait),
        failures: deaths,
    }
}

/// Serves until SIGINT or SIGTERM.
///
/// # Errors
/// When the server cannot start.
pub async fn serve(config: ServeConfig) -> Result<()> {
    let server = Server::start(config).await?;
    tracing::info!("listening on http://{}", server.address());
    let io = |source| ServerError::Io {
        path: "signals".into(),
        source,
    };
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
    use crate::store::{NewToken, Quotas};
    use crate::token::Secret;

    #[tokio::test]
    async fn strangers_are_let_in_by_a_token_or_on_purpose_only() {
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
            assert!(
                matches!(refused, Err(ServerError::Unguarded(_))),
                "{refused:?}"
            );
        }
        start("0.0.0.0:0", true).await.expect("on purpose");
        let store = Store::open(&dir.path().join("fled.db"))
            .await
            .expect("open");
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
