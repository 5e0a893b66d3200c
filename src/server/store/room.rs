//! Room for one more job.

use sqlx::AnyExecutor;

use super::Tx;
use super::engine::counted;
use crate::error::Result;

/// Limits on the number of jobs.
#[derive(Clone, Copy, Debug)]
pub struct Room<'a> {
    /// Queued jobs of all owners.
    pub queue: u32,
    /// An owner, and their limit of queued and running jobs.
    pub of_owner: Option<(&'a str, u32)>,
}

/// The limit that is exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Full {
    Queue,
    Quota,
}

/// Counts the queued jobs.
pub(super) async fn waiting(executor: impl AnyExecutor<'_>) -> Result<u32> {
    let count =
        sqlx::query_scalar("SELECT COUNT(*) FROM jobs WHERE state = 'queued' AND video_of IS NULL");
    counted(count.fetch_one(executor).await?)
}

/// Counts an owner's queued and running jobs.
pub(super) async fn unfinished(executor: impl AnyExecutor<'_>, owner: &str) -> Result<u32> {
    let count = sqlx::query_scalar(
        "SELECT COUNT(*) FROM jobs JOIN captures ON captures.id = jobs.capture_id
         WHERE jobs.state IN ('queued', 'running') AND captures.owner = $1
         AND jobs.video_of IS NULL",
    );
    counted(count.bind(owner).fetch_one(executor).await?)
}

/// The limit that the existing jobs exceed, including the one just inserted.
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
