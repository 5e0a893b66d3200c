//! Makes videos, one after the other, each by a child process that gives way to jobs.

use std::sync::Arc;

use tokio::sync::Notify;

use super::film::{End, film};
use super::record::{Record, VideoFault, VideoFolder, VideoState, videos_of};
use super::turns::Ticket;
use crate::app::App;
use crate::copies::{fetch_job, publish_video};
use crate::error::{Result, ServerError};
use crate::janitor::remove;
use crate::jobs::kill_orphans;
use crate::redaction::without_paths;
use crate::store::now_ms;

/// A video during which the server has died so often is not begun again: memory that runs out
/// takes the server as well.
const MOST_ATTEMPTS: u32 = 3;

/// Lets the videos that an earlier server had not finished wait again.
///
/// # Errors
/// When the database or the data directory cannot be read.
pub async fn take_up(app: &Arc<App>) -> Result<()> {
    let jobs = app.store.ids("jobs").await?;
    let shared = app.clone();
    let found = tokio::task::spawn_blocking(move || unfinished(&shared, jobs));
    let found = found.await.unwrap_or_else(|error| {
        tracing::error!(%error, "cannot look for videos");
        Vec::new()
    });
    // An ffmpeg that outlived its server would write into the file of the next.
    let jobs: Vec<String> = found.iter().map(|ticket| ticket.job.clone()).collect();
    kill_orphans(&jobs);
    for ticket in found {
        app.videos.add(ticket);
    }
    Ok(())
}

/// The oldest first. A record that cannot be read must not keep a server from starting.
fn unfinished(app: &App, jobs: impl IntoIterator<Item = String>) -> Vec<Ticket> {
    let mut found = Vec::new();
    for job in jobs {
        match videos_of(&app.data, &job) {
            Ok(records) => {
                let waiting = records.into_iter().filter(|video| !video.state.is_over());
                found.extend(waiting.map(|video| Ticket {
                    job: job.clone(),
                    id: video.id,
                }));
            }
            Err(error) => tracing::warn!(%error, job, "its videos cannot be read"),
        }
    }
    found.sort_by(|a, b| a.id.cmp(&b.id));
    found
}

/// Makes videos until the server stops.
pub async fn keep_making(app: Arc<App>) {
    loop {
        let (ticket, notifier) = tokio::select! {
            next = app.videos.next() => next,
            () = app.shutdown.cancelled() => return,
        };
        if let Err(error) = make(&app, &ticket, &notifier).await {
            tracing::error!(%error, job = ticket.job, video = ticket.id, "a video was dropped");
        }
        app.videos.end();
    }
}

async fn make(app: &App, ticket: &Ticket, notifier: &Notify) -> Result<()> {
    let Some(folder) = VideoFolder::of(&app.data, &ticket.job, &ticket.id) else {
        return Ok(());
    };
    // Deleted while it waited.
    let Some(mut record) = folder.load()? else {
        return Ok(());
    };
    let end = if record.attempts >= MOST_ATTEMPTS {
        End::Failed(VideoFault {
            detail: format!("the server died {MOST_ATTEMPTS} times while it was made"),
            hint: "Memory may have run out: ask for a smaller one.".to_owned(),
        })
    } else if app.is_disk_full() {
        End::Failed(VideoFault {
            detail: "the server's disk is full".to_owned(),
            hint: "Delete what is no longer needed, then ask for it again.".to_owned(),
        })
    } else {
        record.attempts += 1;
        record.state = VideoState::Running;
        folder.save(&record)?;
        made(app, ticket, &folder, &record, notifier).await
    };
    settle(&folder, record, end).await?;
    match folder.load()? {
        Some(record) if record.state.is_over() => publish_video(app, &ticket.job, &ticket.id).await,
        // It is made again.
        _ => Ok(()),
    }
}

/// Fetches what it shows, where others have made that, and makes it.
async fn made(
    app: &App,
    ticket: &Ticket,
    folder: &VideoFolder,
    record: &Record,
    notifier: &Notify,
) -> End {
    let fetched = tokio::select! {
        fetched = fetch_job(app, &ticket.job) => fetched,
        () = notifier.notified() => return End::Stopped,
        () = app.shutdown.cancelled() => return End::Interrupted,
    };
    if let Err(error) = fetched {
        return End::Failed(VideoFault {
            detail: without_paths(&format!("the scene cannot be fetched: {error}")),
            hint: "Ask for it again once /readyz says that the store of files answers.".to_owned(),
        });
    }
    film(app, ticket, folder, record, notifier).await
}

/// Keeps what came of it.
async fn settle(folder: &VideoFolder, mut record: Record, end: End) -> Result<()> {
    match end {
        // Once more: what was removed while the process still wrote may be there in part.
        End::Stopped => return folder.remove().map(drop),
        End::Interrupted => {
            record.state = VideoState::Queued;
            record.attempts -= 1;
        }
        End::Made => {
            let path = folder.video();
            let about = std::fs::metadata(&path).map_err(ServerError::io(&path))?;
            record.state = VideoState::Succeeded;
            record.bytes = Some(about.len());
            record.finished_at = Some(now_ms());
        }
        End::Failed(error) => {
            tracing::warn!(video = record.id, error.detail, "a video failed");
            // Of a process that died.
            remove(&folder.video().with_added_extension("tmp")).await;
            record.state = VideoState::Failed;
            record.error = Some(error);
            record.finished_at = Some(now_ms());
        }
    }
    if folder.load()?.is_some() {
        return folder.save(&record);
    }
    // Deleted meanwhile, alone or with its job.
    folder.remove().map(drop)
}
