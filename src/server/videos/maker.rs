//! Makes videos, one after the other, each by a child process that gives way to jobs.

use std::ffi::OsString;
use std::process::ExitStatus;
use std::sync::Arc;

use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};

use super::protocol::VideoEvent;
use super::record::{Record, VideoFault, VideoFolder, VideoState, videos_of};
use super::turns::Ticket;
use crate::app::App;
use crate::copies::publish_video;
use crate::error::{Result, ServerError};
use crate::jobs::kill_orphans;
use crate::jobs::process::{Group, Happening, JOB_VARIABLE, Line};
use crate::removal::remove_file;
use crate::store::now_ms;
use crate::wording::without_paths;

/// A video during which the server has died so often is not begun again: memory that runs out
/// takes the server as well.
const MOST_ATTEMPTS: u32 = 3;

/// How the making of a video ended.
enum End {
    Made,
    Failed(VideoFault),
    /// Whoever stopped it has removed it.
    Stopped,
    /// The server stops: it is begun anew by the next one.
    Interrupted,
}

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
        let mut group = match begin(app, ticket, &folder, &record) {
            Ok(group) => group,
            Err(error) => return settle(&folder, record, not_begun(&error)).await,
        };
        let end = watch(app, &mut group, bell).await;
        group.stop(app.limits.grace).await;
        end
    };
    settle(&folder, record, end).await?;
    match folder.load()? {
        Some(record) if record.state.is_over() => publish_video(app, &ticket.job, &ticket.id).await,
        // It is made again.
        _ => Ok(()),
    }
}

fn begin(app: &App, ticket: &Ticket, folder: &VideoFolder, record: &Record) -> Result<Group> {
    let plan = folder.plan();
    let text = serde_json::to_vec(&record.plan).unwrap_or_default();
    std::fs::write(&plan, text).map_err(ServerError::io(&plan))?;
    let output = app.data.output(&ticket.job).root().to_owned();
    let arguments: Vec<OsString> = vec![
        output.into(),
        "--plan".into(),
        plan.clone().into(),
        "--output".into(),
        folder.video().into(),
        "--ffmpeg".into(),
        app.config.ffmpeg.clone().into(),
        "--json".into(),
        "--background".into(),
    ];
    let command = &app.config.video_command;
    let mark = [(JOB_VARIABLE, ticket.job.as_str())];
    let mut group = Group::spawn(command, &arguments, &mark).map_err(ServerError::io(&plan))?;
    // It reads nothing; an open pipe would only hold a descriptor.
    drop(group.stdin.take());
    Ok(group)
}

/// Takes its lines until it ends or has to.
async fn watch(app: &App, group: &mut Group, bell: &Notify) -> End {
    let mut last_words = None;
    let mut silence = Instant::now() + app.limits.silence;
    loop {
        tokio::select! {
            happening = group.next() => match happening {
                Ok(Happening::Line(line)) => {
                    silence = Instant::now() + app.limits.silence;
                    take(app, line, &mut last_words);
                }
                // Its last lines may still come.
                Ok(Happening::Ended(_)) => {}
                Ok(Happening::Closed) => return ended(group.wait().await, last_words),
                Err(error) => return not_begun(&error),
            },
            () = bell.notified() => return End::Stopped,
            () = app.shutdown.cancelled() => return End::Interrupted,
            () = sleep_until(silence) => {
                let detail = format!("it said nothing for {} s", app.limits.silence.as_secs());
                let hint = "Ask for a smaller one.".to_owned();
                return End::Failed(VideoFault { detail, hint });
            }
        }
    }
}

fn take(app: &App, line: Line, last_words: &mut Option<VideoFault>) {
    match line {
        Line::Output(text) => match serde_json::from_str(&text) {
            Ok(VideoEvent::Rendered { done, total }) => app.videos.advance(done, total),
            Ok(VideoEvent::Failed { detail, hint }) => {
                *last_words = Some(VideoFault { detail, hint });
            }
            Err(_) => tracing::info!(text, "video process"),
        },
        Line::Error(text) => tracing::info!(text, "video process"),
    }
}

fn ended(status: std::io::Result<ExitStatus>, last_words: Option<VideoFault>) -> End {
    match (status, last_words) {
        (Ok(status), None) if status.success() => End::Made,
        (_, Some(VideoFault { detail, hint })) => End::Failed(VideoFault {
            detail: without_paths(&detail),
            hint: without_paths(&hint),
        }),
        (Ok(status), None) => End::Failed(VideoFault {
            detail: format!("the process that made it died: {status}"),
            hint: "Try again; the server's log may say more.".to_owned(),
        }),
        (Err(error), None) => not_begun(&error),
    }
}

fn not_begun(error: &dyn std::fmt::Display) -> End {
    End::Failed(VideoFault {
        detail: without_paths(&format!("the process that makes it cannot be run: {error}")),
        hint: "The server's log may say more.".to_owned(),
    })
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
    if folder.path().is_dir() {
        return folder.save(&record);
    }
    // Deleted with its job meanwhile.
    Ok(())
}
