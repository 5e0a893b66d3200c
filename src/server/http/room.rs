//! Room for another job.

use axum::http::StatusCode;

use super::access::Visitor;
use super::problem::Problem;
use crate::app::App;

/// Seconds after which a place in the queue may be free.
const QUEUE_RETRY: u32 = 60;

/// # Errors
/// 503 if the queue is full, 429 if the visitor's quota is used up.
pub(super) async fn check_room(app: &App, visitor: &Visitor) -> Result<(), Problem> {
    let room = visitor.room(app.limits.queue);
    if app.store.waiting().await? >= room.queue {
        return Err(queue_full());
    }
    match room.of_owner {
        Some((owner, most)) if app.store.unfinished(owner).await? >= most => {
            Err(over_quota_jobs(visitor))
        }
        _ => Ok(()),
    }
}

/// 429: the visitor's limit of queued and running jobs is reached.
pub(super) fn over_quota_jobs(visitor: &Visitor) -> Problem {
    let most = visitor.room(0).of_owner.map_or(0, |(_, most)| most);
    Problem::new(
        StatusCode::TOO_MANY_REQUESTS,
        "quota_jobs",
        format!("At most {most} of your jobs may wait or run at a time."),
    )
    .hint("Try again when one has ended, or cancel one.")
    .retry_after(QUEUE_RETRY)
}

pub(super) fn queue_full() -> Problem {
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "queue_full", "Too many jobs are waiting.")
        .hint("Try again when some have ended, or cancel some.")
        .retry_after(QUEUE_RETRY)
}
