//! Workers, each of which runs one job at a time as a child process.

mod attempt;
mod heartbeat;
pub mod log;
mod orphans;
mod words;

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use fled_core::pipeline::error::ErrorKind;
use tokio::sync::Notify;

use crate::app::App;
use crate::config::Limits;
use crate::error::{Result, ServerError};
use crate::failpoint::Failpoint;
use crate::files::remove;
use crate::store::{Claim, Engine, JobError, JobKind, Machine, Settlement};

pub use orphans::kill_orphans;

/// How often an idle worker polls a database file for due retries.
const IDLE: Duration = Duration::from_millis(500);
/// A worker that was not seen for this long is removed from the list, milliseconds.
const FORGOTTEN_MS: i64 = 24 * 3600 * 1000;
/// Pause after a fault of the database or the disk.
const RECOVERY: Duration = Duration::from_secs(2);
/// Pause before a database operation is repeated because the database is busy.
const BUSY_PAUSE: Duration = Duration::from_secs(1);

/// Runs jobs of one kind until the server stops. Never gives up: a fault of the database or the
/// disk is logged, and the operation is tried again.
pub async fn work(app: Arc<App>, kind: JobKind, turn: String) {
    let mut was_full = false;
    let mut queue = app.store.queue();
    let idle = match app.store.engine() {
        Engine::Sqlite => IDLE,
        Engine::Postgres => app.limits.look,
    };
    while !app.shutdown.is_cancelled() {
        if app.is_disk_full() {
            if !was_full {
                tracing::warn!("the disk is full; waiting jobs start once there is space again");
            }
            was_full = true;
            pause(&app, RECOVERY).await;
            continue;
        }
        was_full = false;
        if kind == JobKind::Video && !is_installed(&app.config.ffmpeg) {
            // Another process may make the video, or ffmpeg may be installed.
            pause(&app, idle).await;
            continue;
        }
        // Before the query: a job that is queued during the query triggers another one.
        queue.mark_unchanged();
        match take(&app, kind, &turn).await {
            Ok(Some((claim, cancel))) => {
                app.pass(Failpoint::Claimed);
                let outcome = run(&app, &claim, cancel).await;
                let is_deleted = remove_if_deleted(&app, &claim.job.id).await;
                if let Err(error) = outcome
                    && !is_deleted
                {
                    tracing::error!(%error, job = claim.job.id, "an attempt was dropped");
                    pause(&app, RECOVERY).await;
                }
            }
            Ok(None) => {
                tokio::select! {
                    _ = queue.changed() => {}
                    () = tokio::time::sleep(idle) => {}
                    () = app.shutdown.cancelled() => {}
                }
            }
            Err(error) => {
                tracing::error!(%error, "cannot look for work");
                pause(&app, RECOVERY).await;
            }
        }
    }
}

/// Keeps this worker in the list of workers, and removes those that stopped long ago.
pub async fn keep_registered(app: Arc<App>) {
    let Some(about) = &app.config.about else {
        return;
    };
    let register = async |draining| {
        app.store.see_worker(&app.worker, about, draining).await?;
        let before = app.store.now().await? - FORGOTTEN_MS;
        app.store.forget_workers(None, before).await
    };
    let mut every = tokio::time::interval(app.limits.heartbeat.max(Duration::from_millis(1)));
    loop {
        let draining = tokio::select! {
            _ = every.tick() => false,
            () = app.shutdown.cancelled() => true,
        };
        if let Err(error) = register(draining).await {
            tracing::warn!(%error, "the list of workers is not up to date");
        }
        // The worker stays listed until its jobs have ended.
        if draining {
            return;
        }
    }
}

async fn pause(app: &App, time: Duration) {
    tokio::select! {
        () = tokio::time::sleep(time) => {}
        () = app.shutdown.cancelled() => {}
    }
}

/// Claims a job. Returns the claim and the notifier that stops the job.
async fn take(app: &App, kind: JobKind, turn: &str) -> Result<Option<(Claim, Arc<Notify>)>> {
    let _alone = app.running.claiming().await;
    let released = release_expired(app).await?;
    for job in &released {
        tracing::warn!(job, "the job's worker was lost; the job is queued again");
    }
    let machine = app
        .config
        .about
        .as_ref()
        .map_or(Machine::ANY, |about| Machine { has_gpu: about.has_gpu, memory: about.memory });
    let owner = format!("{}/{turn}", app.worker);
    let (lease, running) = (app.limits.lease_ms(), app.running.jobs());
    let claim = app.store.claim_fit(kind, &owner, lease, &running, machine);
    Ok(claim.await?.map(|claim| {
        let cancel = app.running.begin(&claim.lease);
        (claim, cancel)
    }))
}

/// Queues again the jobs whose worker is dead, frozen or cut off, if workers share a database. With
/// SQLite there is only one process: its jobs run on even if their leases have expired.
async fn release_expired(app: &App) -> Result<Vec<String>> {
    match app.store.engine() {
        Engine::Sqlite => Ok(Vec::new()),
        Engine::Postgres => {
            // Of another machine's memory nothing is known.
            let settle = |deaths| after_death(&app.limits, deaths, false);
            app.store.release_expired(settle).await
        }
    }
}

/// Removes the files of a video that was deleted while it was made, alone or with its job: its
/// process may have written since. Returns whether the video was deleted.
async fn remove_if_deleted(app: &App, id: &str) -> bool {
    let is_deleted = matches!(app.store.files_version(id).await, Ok(None));
    if is_deleted {
        remove(&app.data.job(id)).await;
    }
    is_deleted
}

/// Whether a program exists at its path or on `PATH`.
pub fn is_installed(program: &Path) -> bool {
    if program.components().nth(1).is_some() {
        return program.is_file();
    }
    let folders = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&folders).any(|folder| folder.join(program).is_file())
}

async fn run(app: &App, claim: &Claim, cancel: Arc<Notify>) -> Result<()> {
    let (lease, id) = (&claim.lease, &claim.job.id);
    tracing::info!(job = id, attempt = claim.job.attempts, "job begins");
    let outcome = attempt::run(app, claim, cancel).await;
    app.running.end(lease);
    let settlement = match outcome {
        Ok(settlement) => settlement,
        Err(ServerError::LeaseLost(job)) => return Err(ServerError::LeaseLost(job)),
        Err(error) => {
            tracing::error!(%error, job = id, "the server failed an attempt");
            io_failure(app, claim, &error).await?
        }
    };
    // A cancellation that arrived while the process was ending is still honoured.
    let settlement = match settlement {
        Settlement::Failed { .. } | Settlement::Released
            if app.store.heartbeat(lease, app.limits.lease_ms()).await? =>
        {
            Settlement::Stopped
        }
        other => other,
    };
    let is_alone = app.store.engine() == Engine::Sqlite;
    let state = loop {
        match app.store.settle(lease, &settlement).await {
            Err(error) if error.is_busy() && is_alone && !app.shutdown.is_cancelled() => {
                tracing::warn!(%error, job = id, "the database is busy");
                pause(app, BUSY_PAUSE).await;
            }
            state => break state?,
        }
    };
    app.pass(Failpoint::Settled);
    tracing::info!(job = id, state = state.name(), "attempt settled");
    Ok(())
}

/// An error message without paths, which only the server's log may contain.
fn redacted(error: &ServerError) -> String {
    match error {
        ServerError::Io { source, .. } => format!("a file of the job: {source}"),
        ServerError::Database(_) => "the server's database failed".to_owned(),
        other => other.to_string(),
    }
}

/// The settlement of an attempt that ended with a disk or database error.
async fn io_failure(app: &App, claim: &Claim, error: &ServerError) -> Result<Settlement> {
    let failures = app.store.count_failure(&claim.lease).await?;
    let retry = failures < app.limits.attempts_without_progress;
    let wait = app.limits.retry_wait_ms(ErrorKind::Io, failures);
    let error = JobError {
        code: ErrorKind::Io.name().to_owned(),
        detail: redacted(error),
        hint: advice(error).to_owned(),
    };
    Ok(Settlement::Failed { error, retry_in_ms: retry.then_some(wait), failures })
}

/// Advice on a disk or database error, for the server's administrator.
fn advice(error: &ServerError) -> &'static str {
    match error {
        ServerError::Io { source, .. } if source.kind() == io::ErrorKind::StorageFull => {
            "Free some space for the data directory, then retry the job."
        }
        ServerError::Io { .. } => {
            "Check the disk and the permissions of the data directory, then retry the job."
        }
        _ => "/readyz shows what of the database and the file store is missing.",
    }
}

/// Decides how to settle a job whose server has died this many times in a row without progress.
/// Running out of memory kills the server along with the job, so such a job must not restart
/// forever; `ran_out` says that the kernel has reported it.
pub fn after_death(limits: &Limits, deaths: u32, ran_out: bool) -> Settlement {
    let again = deaths < limits.deaths_without_progress;
    // At once after the first death, as after a manual restart.
    let wait = match deaths {
        0 | 1 => 0,
        _ => limits.retry_wait_ms(ErrorKind::Internal, deaths - 1),
    };
    // While it is tried again, what the kernel ended may have been another process.
    let kind = if ran_out && !again { ErrorKind::OomHost } else { ErrorKind::Internal };
    let detail = match (again, ran_out) {
        (true, false) => "continued after a restart of the server".to_owned(),
        (true, true) => {
            "continued after a restart of the server: the kernel reported a lack of memory"
                .to_owned()
        }
        (false, _) => {
            format!("the server died {deaths} times without progress while this job ran")
        }
    };
    let hint = match (again, ran_out) {
        (_, true) => {
            "The kernel ended a process because memory ran out. Try a smaller `size` or `cap`, or \
             another machine."
        }
        (true, false) => "",
        (false, false) => {
            "The log of the server, or of what supervises it, may say why. Then retry the job."
        }
    };
    Settlement::Failed {
        error: JobError { code: kind.name().to_owned(), detail, hint: hint.to_owned() },
        retry_in_ms: again.then_some(wait),
        failures: deaths,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_the_kernel_reported_is_called_a_lack_of_memory() {
        let of = |deaths, ran_out| match after_death(&Limits::default(), deaths, ran_out) {
            Settlement::Failed { error, retry_in_ms, .. } => (error, retry_in_ms),
            other => panic!("{other:?}"),
        };
        let (error, wait) = of(1, false);
        assert_eq!(
            (error.detail.as_str(), wait),
            ("continued after a restart of the server", Some(0))
        );
        // While it is tried again, another process may have been the one.
        for (deaths, code) in [(1, "internal"), (5, "oom_host")] {
            let (error, _) = of(deaths, false);
            assert!(!format!("{error:?}").to_lowercase().contains("memory"), "{error:?}");
            let (error, _) = of(deaths, true);
            assert_eq!(error.code, code);
            assert!(error.hint.contains("smaller `size`"), "{error:?}");
        }
        assert_eq!(of(5, true).1, None);
    }
}
