//! One attempt at a job: its process from start to settlement.

use std::ffi::OsString;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::sync::Arc;
use std::time::Duration;

use fled_core::event::Event;
use fled_core::pipeline::config::{Options, Preset};
use fled_core::pipeline::error::ErrorKind;
use serde_json::Value;
use tokio::sync::Notify;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval, sleep_until};

use super::heartbeat::{Heartbeat, Pulse};
use super::log::LogWriter;
use super::words::{closing_line, is_milestone, is_seen, readable};
use crate::app::App;
use crate::error::{Result, ServerError};
use crate::failpoint::Failpoint;
use crate::files::data::{sync_directories, write_atomically};
use crate::files::remove;
use crate::memory;
use crate::process::{Group, Happening, JOB_VARIABLE, Line};
use crate::redaction::without_paths;
use crate::sharing;
use crate::store::{Claim, Engine, JobError, JobRow, Lease, Progress, Settlement};
use crate::validation;

/// How long to wait for output of other processes in the group after the job's process has ended.
const DRAIN: Duration = Duration::from_secs(2);

/// Why an attempt's loop ends.
enum End {
    /// The process ended by itself.
    Exited(ExitStatus),
    /// The process has to be stopped.
    Stop(Settlement),
}

/// The next action of an attempt.
enum Due {
    Line(Line),
    Publishing,
    Progress,
}

/// The outcome that a job's process reported.
enum LastWords {
    Finished { best_round: u32 },
    Failed { kind: String, detail: String, hint: String },
}

pub(super) struct Attempt<'a> {
    app: &'a App,
    lease: Lease,
    is_video: bool,
    log: LogWriter,
    /// How often the kernel had ended a process for lack of memory when the attempt began.
    kills: Option<u64>,
    pending: Option<Progress>,
    last_words: Option<LastWords>,
}

/// Runs the job's process to its end and returns how to settle the job, without settling it.
///
/// # Errors
/// [`ServerError::LeaseLost`] if another worker has taken over the job; the process is stopped.
pub(super) async fn run(app: &App, claim: &Claim, cancel: Arc<Notify>) -> Result<Settlement> {
    let (lease, job, id) = (&claim.lease, &claim.job, &claim.job.id);
    // From the start: fetching files may take longer than a lease.
    let mut heartbeat = Heartbeat::begin(app, lease.clone());
    if let Some(settlement) = prepare(app, claim, &cancel, &mut heartbeat).await? {
        return Ok(settlement);
    }
    app.pass(Failpoint::Fetched);
    let (command, arguments) = prepare_process(app, job)?;
    let log = app.data.log(id);
    let log = LogWriter::open(&log, app.limits.max_log_bytes).map_err(ServerError::io(&log))?;
    let mut attempt = Attempt {
        app,
        lease: lease.clone(),
        is_video: job.video_of.is_some(),
        log,
        kills: memory::kills(),
        pending: None,
        last_words: None,
    };
    // If this process is killed, the next one compares.
    if let Err(error) = memory::note(&app.data.oom_kills()) {
        tracing::warn!(%error, "a later lack of memory will not be recognised");
    }
    let begins = format!("attempt {} begins", job.attempts);
    attempt.log.line(&begins);
    let mut group = match Group::spawn(command, &arguments, &[(JOB_VARIABLE, id)]) {
        Ok(group) => group,
        Err(error) => return attempt.not_started(&error).await,
    };
    // The job's process reads no input; an open pipe would only hold a descriptor.
    drop(group.stdin.take());
    app.pass(Failpoint::Started);
    let outcome = attempt.watch(&mut group, &cancel, &mut heartbeat).await;
    if let Ok(End::Stop(Settlement::Released)) = outcome {
        // Another worker continues from its files: let it save the current step.
        group.stop(app.limits.draining).await;
        attempt.drain_output(&mut group).await;
    } else {
        group.stop(app.limits.grace).await;
    }
    app.pass(Failpoint::Ended);
    let settlement = match outcome? {
        End::Exited(status) => attempt.settle(status).await?,
        End::Stop(settlement) => settlement,
    };
    attempt.log.line(&closing_line(&settlement));
    if attempt.is_video && !matches!(settlement, Settlement::Filmed { .. }) {
        // A remade video starts from scratch.
        remove(app.data.output(id).root()).await;
    }
    remove_live_picture(app, id).await;
    sharing::publish(app, lease, true).await?;
    app.pass(Failpoint::Published);
    Ok(settlement)
}

/// Creates the output folder of a job and its options file. Returns the command and the arguments
/// of its process.
fn prepare_process<'a>(app: &'a App, job: &JobRow) -> Result<(&'a [OsString], Vec<OsString>)> {
    let output = app.data.output(&job.id).root().to_owned();
    std::fs::create_dir_all(&output).map_err(ServerError::io(&output))?;
    let path = app.data.job(&job.id).join("options.json");
    let options = match &job.video_of {
        Some(_) => job.options.clone(),
        // An older build may have stored options that no longer exist.
        None => Value::Object(Options::known(&job.options)),
    };
    write_atomically(&path, options.to_string().as_bytes()).map_err(ServerError::io(&path))?;
    let (command, arguments): (_, Vec<OsString>) = match &job.video_of {
        Some(shown) => (
            &app.config.video_command,
            vec![
                app.data.output(shown).root().into(),
                "--plan".into(),
                path.into(),
                "--output".into(),
                app.data.video(&job.id).into(),
                "--ffmpeg".into(),
                app.config.ffmpeg.clone().into(),
                "--json".into(),
                "--background".into(),
            ],
        ),
        None => (
            &app.config.job_command,
            vec![
                validation::source(app.data.capture(&job.capture_id)).into(),
                "--out".into(),
                output.into(),
                // What the options of an older build lack is the default's.
                "--preset".into(),
                Preset::Standard.name().into(),
                "--options".into(),
                path.into(),
                "--cache".into(),
                app.data.cache().into(),
                "--json".into(),
            ],
        ),
    };
    Ok((command, arguments))
}

/// Fetches the files that a job starts from. Returns `Some` if the attempt ends meanwhile: all that
/// was fetched is complete, and nothing has been made yet.
async fn prepare(
    app: &App,
    claim: &Claim,
    cancel: &Notify,
    heartbeat: &mut Heartbeat,
) -> Result<Option<Settlement>> {
    tokio::select! {
        prepared = sharing::prepare_job(app, claim) => prepared.map(|()| None),
        settlement = stopped(app, &claim.job.id, cancel, heartbeat) => settlement.map(Some),
    }
}

/// Waits for an external event that ends an attempt.
async fn stopped(
    app: &App,
    job: &str,
    cancel: &Notify,
    heartbeat: &mut Heartbeat,
) -> Result<Settlement> {
    tokio::select! {
        pulse = heartbeat.next() => match pulse {
            Pulse::Cancel => Ok(Settlement::Stopped),
            Pulse::Lost => Err(ServerError::LeaseLost(job.to_owned())),
        },
        () = cancel.notified() => Ok(Settlement::Stopped),
        () = app.shutdown.cancelled() => {
            app.pass(Failpoint::Stopping);
            Ok(Settlement::Released)
        }
    }
}

/// Removes the preview of a stopped training; a successful one has removed its own.
async fn remove_live_picture(app: &App, id: &str) {
    let path = app.data.output(id).work().live_picture();
    match tokio::fs::remove_file(&path).await {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            tracing::warn!(job = id, %error, "cannot remove a live picture");
        }
        _ => {}
    }
}

impl Attempt<'_> {
    /// Handles the output of the process and keeps the lease until the process ends or must be
    /// stopped.
    async fn watch(
        &mut self,
        group: &mut Group,
        cancel: &Notify,
        heartbeat: &mut Heartbeat,
    ) -> Result<End> {
        let (app, job) = (self.app, self.lease.job.clone());
        let limits = app.limits;
        let wall = Instant::now() + limits.wall;
        let mut silence = Instant::now() + limits.silence;
        let mut publish = ticks(limits.publish);
        let mut flush = ticks(limits.progress_interval);
        let mut exited: Option<(ExitStatus, Instant)> = None;
        loop {
            let drained = exited.map_or(wall, |(_, at)| at + DRAIN);
            let due = tokio::select! {
                happening = group.next() => match happening.map_err(|source| ServerError::Io { path: "job".into(), source })? {
                    Happening::Line(line) => {
                        silence = Instant::now() + limits.silence;
                        Due::Line(line)
                    }
                    Happening::Ended(status) => {
                        exited = Some((status, Instant::now()));
                        continue;
                    }
                    // No more output can follow.
                    Happening::Closed => match exited {
                        Some((status, _)) => return Ok(End::Exited(status)),
                        None => return self.exit(group).await,
                    },
                },
                end = stopped(app, &job, cancel, heartbeat) => return end.map(End::Stop),
                _ = publish.tick() => Due::Publishing,
                _ = flush.tick() => Due::Progress,
                () = sleep_until(silence) => return self.timed_out("was silent", limits.silence).await,
                () = sleep_until(drained) => match exited {
                    Some((status, _)) => return Ok(End::Exited(status)),
                    None => return self.timed_out("ran", limits.wall).await,
                },
            };
            let begun = Instant::now();
            // Events that end the attempt are handled even if the database or the blob store is
            // slow.
            tokio::select! {
                done = self.follow(due) => done?,
                end = stopped(app, &job, cancel, heartbeat) => return end.map(End::Stop),
            }
            // What the process wrote meanwhile was not read.
            silence += begun.elapsed();
        }
    }

    /// Logs the remaining output of a stopped process; its events no longer count.
    async fn drain_output(&mut self, group: &mut Group) {
        while let Ok(Some(line)) = tokio::time::timeout(DRAIN, group.next_line()).await {
            let text = match line {
                Line::Error(text) => text,
                Line::Output(text) => match serde_json::from_str::<Event>(&text) {
                    Ok(Event::Log { message }) => message,
                    Ok(_) => continue,
                    Err(_) => text,
                },
            };
            self.log.line(&text);
        }
    }

    async fn follow(&mut self, due: Due) -> Result<()> {
        match due {
            Due::Line(line) => self.take(line).await,
            Due::Publishing => self.publish().await,
            Due::Progress => self.write_pending().await,
        }
    }

    async fn exit(&self, group: &mut Group) -> Result<End> {
        match tokio::time::timeout(DRAIN, group.wait()).await {
            Ok(Ok(status)) => Ok(End::Exited(status)),
            Ok(Err(source)) => Err(ServerError::Io { path: "job".into(), source }),
            Err(_) => self.timed_out("closed its output but kept running", DRAIN).await,
        }
    }

    async fn timed_out(&self, what: &str, limit: Duration) -> Result<End> {
        let detail = format!("{} {what} for {} s and was stopped", self.process(), limit.as_secs());
        let hint = self.hint("The log shows what it did last. A smaller preset takes less time.");
        Ok(End::Stop(self.failure(ErrorKind::Timeout, detail, hint.to_owned()).await?))
    }

    async fn take(&mut self, line: Line) -> Result<()> {
        let text = match line {
            Line::Error(text) => {
                self.log.line(&text);
                return Ok(());
            }
            Line::Output(text) => text,
        };
        match serde_json::from_str::<Event>(&text) {
            Ok(event) => self.event(event).await,
            // Output of tools on the wrong stream is worth keeping, but is no failure.
            Err(_) => {
                self.log.line(&text);
                Ok(())
            }
        }
    }

    async fn event(&mut self, event: Event) -> Result<()> {
        match event {
            Event::Log { message } => self.log.line(&message),
            Event::StageAdvanced { stage, round, done, total, steps_per_second } => {
                let pending = self.pending.get_or_insert_default();
                pending.stage = Some((stage, round, done, total));
                pending.steps_per_second = steps_per_second;
            }
            Event::Progress { progress, eta_seconds } => {
                let pending = self.pending.get_or_insert_default();
                pending.progress = progress.is_finite().then(|| progress.clamp(0.0, 1.0));
                pending.eta_seconds = eta_seconds.filter(|eta| eta.is_finite());
            }
            Event::Finished { best_round, .. } => {
                self.last_words = Some(LastWords::Finished { best_round });
            }
            Event::Failed { kind, detail, hint } => {
                self.last_words = Some(LastWords::Failed { kind, detail, hint });
            }
            event => {
                // In order of arrival.
                self.write_pending().await?;
                if is_milestone(&event) {
                    self.publish().await?;
                }
                if !is_seen(&event) {
                    self.log.line(&readable(&event));
                }
                while let Err(error) = self.app.store.record(&self.lease, &event).await {
                    self.pause_if_busy(error).await?;
                }
                self.app.pass(Failpoint::Recorded);
            }
        }
        Ok(())
    }

    /// Pauses after a database operation that is to be repeated because the database was busy: that
    /// is no fault of the job. A database with rivals must answer in time.
    ///
    /// # Errors
    /// Any other error.
    async fn pause_if_busy(&self, error: ServerError) -> Result<()> {
        if !error.is_busy() || self.app.store.engine() != Engine::Sqlite {
            return Err(error);
        }
        tracing::warn!(%error, job = self.lease.job, "the database is busy");
        tokio::time::sleep(super::BUSY_PAUSE).await;
        Ok(())
    }

    /// Publishes the files so far to a shared blob store. If the store is unavailable for a while,
    /// the attempt continues; its end, which must be published, waits for the store.
    async fn publish(&self) -> Result<()> {
        if self.is_video {
            // Half a video cannot be resumed.
            return Ok(());
        }
        match sharing::publish(self.app, &self.lease, false).await {
            Err(ServerError::LeaseLost(job)) => Err(ServerError::LeaseLost(job)),
            Err(error) => {
                tracing::warn!(%error, job = self.lease.job, "the job's files are published later");
                Ok(())
            }
            Ok(()) => Ok(()),
        }
    }

    async fn write_pending(&mut self) -> Result<()> {
        if let Some(progress) = self.pending.take() {
            while let Err(error) = self.app.store.advance(&self.lease, &progress).await {
                self.pause_if_busy(error).await?;
            }
            self.app.pass(Failpoint::Advanced);
        }
        Ok(())
    }

    /// Decides how to settle a process that ended by itself.
    async fn settle(&mut self, status: ExitStatus) -> Result<Settlement> {
        if let Some(progress) = self.pending.take() {
            match self.app.store.advance(&self.lease, &progress).await {
                // The settlement follows at once.
                Err(error) if error.is_busy() => {}
                outcome => outcome?,
            }
        }
        match self.last_words.take() {
            Some(LastWords::Finished { best_round }) if status.success() => {
                self.sync_output().await?;
                if !self.is_video {
                    return Ok(Settlement::Finished { best_round });
                }
                let path = self.app.data.video(&self.lease.job);
                let about = std::fs::metadata(&path).map_err(ServerError::io(&path))?;
                let bytes = about.len();
                Ok(Settlement::Filmed { bytes })
            }
            Some(LastWords::Failed { kind, detail, hint }) => {
                let kind = ErrorKind::from_name(&kind);
                // Stopping the whole service may signal every process.
                if kind == Some(ErrorKind::Cancelled) && self.app.shutdown.is_cancelled() {
                    return Ok(Settlement::Released);
                }
                // Not requested through this server: something else stopped the process.
                let kind = kind.filter(|&kind| kind != ErrorKind::Cancelled);
                self.failure(kind.unwrap_or(ErrorKind::Internal), detail, hint).await
            }
            _ => {
                let detail = format!("{} ended without a result ({status})", self.process());
                let kills = self.kills.zip(memory::kills());
                let is_risen = kills.is_some_and(|(before, now)| now > before);
                let ran_out = is_risen && status.signal() == Some(9);
                let hint = self.hint(if ran_out {
                    "Memory ran out. Try a smaller `size` or `cap`, or another machine."
                } else {
                    "The log shows what it did last."
                });
                let kind = if ran_out { ErrorKind::OomHost } else { ErrorKind::Internal };
                self.failure(kind, detail, hint.to_owned()).await
            }
        }
    }

    /// The name of its process in messages.
    fn process(&self) -> &'static str {
        if self.is_video { "the video's process" } else { "the job's process" }
    }

    /// What to do about it: the log of a video is for the server's operator.
    fn hint(&self, of_scene: &'static str) -> &'static str {
        if self.is_video {
            "Ask for a smaller one; the server's log may say more."
        } else {
            of_scene
        }
    }

    /// Syncs the names of the results to disk: they must survive a power cut if the report of them
    /// does.
    async fn sync_output(&self) -> Result<()> {
        let output = self.app.data.output(&self.lease.job).root().to_owned();
        let synced = {
            let output = output.clone();
            tokio::task::spawn_blocking(move || sync_directories(&output)).await
        };
        synced
            .unwrap_or_else(|error| Err(std::io::Error::other(error)))
            .map_err(ServerError::io(&output))
    }

    async fn not_started(&self, error: &std::io::Error) -> Result<Settlement> {
        let detail = format!("{} could not be started: {error}", self.process());
        self.failure(
            ErrorKind::Environment,
            detail,
            "Check the installation with `fled doctor`.".into(),
        )
        .await
    }

    /// Decides between another attempt and failure.
    async fn failure(&self, kind: ErrorKind, detail: String, hint: String) -> Result<Settlement> {
        let failures = self.app.store.count_failure(&self.lease).await?;
        let retry = kind.retryable() && failures < self.app.limits.attempts_without_progress;
        let wait = self.app.limits.retry_wait_ms(kind, failures);
        // With paths, for the operator.
        tracing::warn!(job = self.lease.job, kind = kind.name(), detail, "an attempt failed");
        let error = JobError { code: kind.name().to_owned(), detail: without_paths(&detail), hint };
        Ok(Settlement::Failed { error, retry_in_ms: retry.then_some(wait), failures })
    }
}

fn ticks(period: Duration) -> Interval {
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}
