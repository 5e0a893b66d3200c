//! Workers: each takes one job after the other.

use std::sync::Arc;
use std::time::Duration;

use fled_core::pipeline::error::ErrorKind;
use tokio::sync::Notify;

use super::attempt;
use crate::coordinator::Assignment;
use crate::error::{Result, ServerError};
use crate::point::Point;
use crate::store::{JobError, Machine, Settlement};
use crate::traces::AttemptTrace;
use crate::workshop::Workshop;

/// After a fault of the database or the disk.
const RECOVERY: Duration = Duration::from_secs(2);

/// Runs jobs until the server stops. Never gives up: a fault of the database or the disk is
/// logged and tried again.
pub async fn work(work: Workshop, turn: u32) {
    let mut was_full = false;
    let idle = work.coordinator.idle(&work.limits);
    while !work.shutdown.is_cancelled() {
        if work.is_disk_full() {
            if !was_full {
                tracing::warn!("the disk is full: waiting jobs begin when there is space again");
            }
            was_full = true;
            pause(&work, RECOVERY).await;
            continue;
        }
        was_full = false;
        match take(&work, turn).await {
            Ok(Some((job, cancel))) => {
                work.pass(Point::Claimed);
                work.changed();
                if let Err(error) = run(&work, &job, cancel).await {
                    tracing::error!(%error, job = job.lease.job, "an attempt was dropped");
                    pause(&work, RECOVERY).await;
                }
            }
            Ok(None) => {
                tokio::select! {
                    () = work.wake.notified() => {}
                    () = tokio::time::sleep(idle) => {}
                    () = work.shutdown.cancelled() => {}
                }
            }
            Err(error) => {
                tracing::error!(%error, "cannot look for work");
                pause(&work, RECOVERY).await;
            }
        }
    }
}

async fn pause(work: &Workshop, time: Duration) {
    tokio::select! {
        () = tokio::time::sleep(time) => {}
        () = work.shutdown.cancelled() => {}
    }
}

/// Claims a job, and what rings to stop it.
async fn take(work: &Workshop, turn: u32) -> Result<Option<(Assignment, Arc<Notify>)>> {
    let _alone = work.running.claiming().await;
    let released = work.coordinator.release_expired().await?;
    for job in &released {
        tracing::warn!(job, "its worker was not heard of any more: it waits again");
    }
    if !released.is_empty() {
        work.changed();
    }
    let machine = work
        .config
        .about
        .as_ref()
        .map_or(Machine::ANY, |about| Machine {
            has_gpu: about.has_gpu,
            memory: about.memory,
        });
    let turn = (&*work.worker, turn);
    let running = work.running.jobs();
    let claim = work.coordinator.claim(turn, &running, machine).await?;
    Ok(claim.map(|job| {
        let cancel = work.running.begin(&job.lease);
        (job, cancel)
    }))
}

async fn run(work: &Workshop, job: &Assignment, cancel: Arc<Notify>) -> Result<()> {
    let id = &job.lease.job;
    tracing::info!(job = id, attempt = job.attempt, "job begins");
    let mut trace = AttemptTrace::begin(&work.traces, job, &work.worker);
    let outcome = attempt::run(work, job, cancel, &mut trace).await;
    work.running.end(&job.lease);
    let settlement = match outcome {
        Ok(settlement) => settlement,
        Err(ServerError::LeaseLost(job)) => return Err(ServerError::LeaseLost(job)),
        Err(error) => {
            tracing::error!(%error, job = id, "the server failed an attempt");
            io_failure(work, job, &error).await?
        }
    };
    // A cancel that came while the process was ending by itself is honoured all the same.
    let settlement = match settlement {
        Settlement::Failed { .. } | Settlement::Released
            if work.coordinator.heartbeat(&job.lease).await? =>
        {
            Settlement::Stopped
        }
        other => other,
    };
    let state = work.coordinator.settle(&job.lease, &settlement).await?;
    work.pass(Point::Settled);
    trace.end(&settlement);
    tracing::info!(job = id, state = state.name(), "attempt settled");
    work.changed();
    Ok(())
}

/// A fault in words without paths: where the server keeps its files is in its log only.
fn told(error: &ServerError) -> String {
    match error {
        ServerError::Io { source, .. } => format!("a file of the job: {source}"),
        ServerError::Database(_) => "the server's database refused".to_owned(),
        ServerError::Away { .. } => "the worker did not reach the server".to_owned(),
        ServerError::Refused { .. } => "the server refused what the worker told it".to_owned(),
        other => other.to_string(),
    }
}

/// The settlement of an attempt that the disk or the database ended.
async fn io_failure(work: &Workshop, job: &Assignment, error: &ServerError) -> Result<Settlement> {
    let failures = work.coordinator.count_failure(&job.lease).await?;
    let retry = failures < work.limits.attempts_without_progress;
    let wait = work.limits.retry_wait_ms(ErrorKind::Io, failures);
    let error = JobError {
        code: ErrorKind::Io.name().to_owned(),
        detail: told(error),
        hint: "Check the free space and the permissions of the data directory.".to_owned(),
    };
    Ok(Settlement::Failed {
        error,
        retry_in_ms: retry.then_some(wait),
        failures,
    })
}
