//! Whether one more job may wait.

use sqlx::AnyExecutor;

use super::Tx;
use super::engine::counted;
use crate::error::Result;

/// How many jobs there may be.
#[derive(Clone, Copy, Debug)]
pub struct Room<'a> {
    /// Of everybody, that wait.
    pub queue: u32,
    /// An owner, and how many of theirs may wait or run.
    pub of_owner: Option<(&'a str, u32)>,
}

/// Where there is no room for a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Full {
    Queue,
    Quota,
}

/// How many jobs wait for a worker.
pub(super) async fn waiting(executor: impl AnyExecutor<'_>) -> Result<u32> {
    let count = sqlx::query_scalar("SELECT COUNT(*) FROM jobs WHERE state = 'queued'");
    counted(count.fetch_one(executor).await?)
}

/// How many jobs of an owner wait or run.
pub(super) async fn unfinished(executor: impl AnyExecutor<'_>, owner: &str) -> Result<u32> {
    let count = sqlx::query_scalar(
        "SELECT COUNT(*) FROM jobs JOIN captures ON captures.id = jobs.capture_id
         WHERE jobs.state IN ('queued', 'running') AND captures.owner = $1",
    );
    counted(count.bind(owner).fetch_one(executor).await?)
}

/// Where there is no room for the jobs that there are, one that was just queued among them.
pub(super) async fn full(tx: &mut Tx, room: Room<'_>) -> Result<Option<Full>> {
    if waiting(&mut **tx).await? > room.queue {
        return Ok(Some(Full::Queue));
    }
    let Some((owner, most)) = room.of_owner else {
        return Ok(None);
    };
    let theirs = unfinished(&mut **tx, owner).await?;
    Ok((theirs > most).then_some(Full::Quota))
}
