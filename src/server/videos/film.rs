//! The child process that makes a video, from its start to its end.

use std::ffi::OsString;
use std::process::ExitStatus;

use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};

use super::protocol::VideoEvent;
use super::record::{Record, VideoFault, VideoFolder};
use super::turns::Ticket;
use crate::app::App;
use crate::jobs::process::{Group, Happening, JOB_VARIABLE, Line};
use crate::redaction::without_paths;

/// How the making of a video ended.
#[derive(Debug)]
pub enum End {
    /// It is there.
    Made,
    /// It cannot be made.
    Failed(VideoFault),
    /// Nobody wants it any more.
    Stopped,
    /// The server stops.
    Interrupted,
}

/// Makes a video in its folder, unless it is stopped.
pub async fn film(
    app: &App,
    ticket: &Ticket,
    folder: &VideoFolder,
    record: &Record,
    stop: &Notify,
) -> End {
    let mut group = match begin(app, ticket, folder, record) {
        Ok(group) => group,
        Err(error) => return not_begun(&error),
    };
    let end = tokio::select! {
        end = watch(app, &mut group) => end,
        () = stop.notified() => End::Stopped,
        () = app.shutdown.cancelled() => End::Interrupted,
    };
    group.stop(app.limits.grace).await;
    end
}

fn begin(
    app: &App,
    ticket: &Ticket,
    folder: &VideoFolder,
    record: &Record,
) -> std::io::Result<Group> {
    let plan = folder.plan();
    let text = serde_json::to_vec(&record.plan).unwrap_or_default();
    std::fs::write(&plan, text)?;
    let output = app.data.output(&ticket.job).root().to_owned();
    let arguments: Vec<OsString> = vec![
        output.into(),
        "--plan".into(),
        plan.into(),
        "--output".into(),
        folder.video().into(),
        "--ffmpeg".into(),
        app.config.ffmpeg.clone().into(),
        "--json".into(),
        "--background".into(),
    ];
    let mark = [(JOB_VARIABLE, ticket.job.as_str())];
    let mut group = Group::spawn(&app.config.video_command, &arguments, &mark)?;
    // It reads nothing; an open pipe would only hold a descriptor.
    drop(group.stdin.take());
    Ok(group)
}

/// Takes its lines until it ends or has to.
async fn watch(app: &App, group: &mut Group) -> End {
    let mut last_words = None;
    let limit = app.limits.silence;
    let mut silence = Instant::now() + limit;
    loop {
        tokio::select! {
            happening = group.next() => match happening {
                Ok(Happening::Line(line)) => {
                    silence = Instant::now() + limit;
                    take(app, line, &mut last_words);
                }
                // Its last lines may still come.
                Ok(Happening::Ended(_)) => {}
                Ok(Happening::Closed) => return ended(group.wait().await, last_words),
                Err(error) => return not_begun(&error),
            },
            () = sleep_until(silence) => {
                let detail = format!("it said nothing for {} s", limit.as_secs());
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
