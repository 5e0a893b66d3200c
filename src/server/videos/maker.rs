//! Makes videos, one after the other, each by a child process that gives way to jobs, or
//! by a worker.

use std::sync::Arc;

use tokio::sync::Notify;

use super::film::{End, Film};
use super::record::{MadeBy, Record, VideoFault, VideoFolder, VideoState, videos_of};
use super::turns::Ticket;
use crate::app::App;
use crate::coordinator::Task;
use crate::copies::{below, publish_video};
use crate::errands::ask;
use crate::error::{Result, ServerError};
use crate::jobs::kill_orphans;
use crate::removal::remove_file;
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
        let (ticket, bell) = tokio::select! {
            next = app.videos.next() => next,
            () = app.shutdown.cancelled() => return,
        };
        if let Err(error) = make(&app, &ticket, &bell).await {
            tracing::error!(%error, job = ticket.job, video = ticket.id, "a video was dropped");
        }
        app.videos.end();
    }
}

async fn make(app: &App, ticket: &Ticket, bell: &Notify) -> Result<()> {
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
        made(app, ticket, &folder, &mut record, bell).await
    };
    settle(&folder, record, end).await?;
    match folder.load()? {
        Some(record) if record.state.is_over() => publish_video(app, &ticket.job, &ticket.id).await,
        // It is made again.
        _ => Ok(()),
    }
}

/// Makes it here, or lets a worker make it.
async fn made(
    app: &App,
    ticket: &Ticket,
    folder: &VideoFolder,
    record: &mut Record,
    bell: &Notify,
) -> End {
    match by_worker(app, ticket, folder, record, bell).await {
        Ok(Some(end)) => {
            record.made_by = Some(MadeBy::Worker);
            return end;
        }
        Ok(None) => {}
        Err(error) => tracing::warn!(%error, video = ticket.id, "no worker made it: made here"),
    }
    record.made_by = Some(MadeBy::Server);
    let output = app.data.output(&ticket.job);
    let film = Film {
        config: &app.config,
        job: &ticket.job,
        output: output.root(),
        plan: &record.plan,
        plan_file: &folder.plan(),
        video: &folder.video(),
    };
    let advance = |done, total| app.videos.advance(done, total);
    film.make(bell, &app.shutdown, advance).await
}

/// `None` where no worker does it.
async fn by_worker(
    app: &App,
    ticket: &Ticket,
    folder: &VideoFolder,
    record: &Record,
    bell: &Notify,
) -> Result<Option<End>> {
    let (root, output) = (app.data.job(&ticket.job), app.data.output(&ticket.job));
    let files = [output.scene_of(record.plan.round), output.cameras()];
    let files = files.map(|path| below(&root, &path));
    let plan = Box::new(record.plan.clone());
    let task = Task::Video { plan };
    let advance = |done, total| app.videos.advance(done, total);
    let made = async {
        let asked = ask(app, &ticket.job, &files, &task, advance).await?;
        let (Some(blob), Some(blobs)) = (asked, app.mirror.blobs()) else {
            return Ok(None);
        };
        blobs.fetch(&blob, &folder.video()).await?;
        Ok(Some(End::Made))
    };
    tokio::select! {
        made = made => made,
        () = bell.notified() => Ok(Some(End::Stopped)),
        () = app.shutdown.cancelled() => Ok(Some(End::Interrupted)),
    }
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
            remove_file(&folder.video().with_added_extension("tmp")).await;
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
