//! The child process that makes a video, from its start to its end.

use std::ffi::OsString;
use std::path::Path;
use std::process::ExitStatus;

use fled_core::video::Plan;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

use super::protocol::VideoEvent;
use super::record::VideoFault;
use crate::config::ServeConfig;
use crate::jobs::process::{Group, Happening, JOB_VARIABLE, Line};
use crate::wording::without_paths;

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

/// A video to be made.
#[derive(Debug)]
pub struct Film<'a> {
    /// What starts the process.
    pub config: &'a ServeConfig,
    /// Whose result it shows.
    pub job: &'a str,
    /// The result.
    pub output: &'a Path,
    /// Its way and its pictures.
    pub plan: &'a Plan,
    /// Where the process reads that.
    pub plan_file: &'a Path,
    /// Where the video goes.
    pub video: &'a Path,
}

impl Film<'_> {
    /// Makes it, unless it is stopped; `advance` hears how many pictures of how many are done.
    pub async fn make(
        &self,
        stop: &Notify,
        shutdown: &CancellationToken,
        advance: impl Fn(u32, u32),
    ) -> End {
        let mut group = match self.begin() {
            Ok(group) => group,
            Err(error) => return not_begun(&error),
        };
        let end = tokio::select! {
            end = self.watch(&mut group, advance) => end,
            () = stop.notified() => End::Stopped,
            () = shutdown.cancelled() => End::Interrupted,
        };
        group.stop(self.config.limits.grace).await;
        end
    }

    fn begin(&self) -> std::io::Result<Group> {
        let text = serde_json::to_vec(self.plan).unwrap_or_default();
        std::fs::write(self.plan_file, text)?;
        let arguments: Vec<OsString> = vec![
            self.output.into(),
            "--plan".into(),
            self.plan_file.into(),
            "--output".into(),
            self.video.into(),
            "--ffmpeg".into(),
            self.config.ffmpeg.clone().into(),
            "--json".into(),
            "--background".into(),
        ];
        let mark = [(JOB_VARIABLE, self.job)];
        let mut group = Group::spawn(&self.config.video_command, &arguments, &mark)?;
        // It reads nothing; an open pipe would only hold a descriptor.
        drop(group.stdin.take());
        Ok(group)
    }

    /// Takes its lines until it ends or has to.
    async fn watch(&self, group: &mut Group, advance: impl Fn(u32, u32)) -> End {
        let mut last_words = None;
        let limit = self.config.limits.silence;
        let mut silence = Instant::now() + limit;
        loop {
            tokio::select! {
                happening = group.next() => match happening {
                    Ok(Happening::Line(line)) => {
                        silence = Instant::now() + limit;
                        take(line, &advance, &mut last_words);
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
}

fn take(line: Line, advance: &impl Fn(u32, u32), last_words: &mut Option<VideoFault>) {
    match line {
        Line::Output(text) => match serde_json::from_str(&text) {
            Ok(VideoEvent::Rendered { done, total }) => advance(done, total),
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
