//! Upload validation, one process per upload.
//!
//! The files to decode are untrusted and may crash a decoder, keep it busy forever or exhaust its
//! memory. In a separate process with limits, such a file fails one upload and not the service.

mod words;
mod work;

use std::ffi::OsString;
use std::io;
use std::process::ExitStatus;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::runtime::Handle;
use tokio::sync::{MutexGuard, Semaphore, SemaphorePermit};
use tokio::time::{Instant, timeout_at};

use crate::config::Limits;
use crate::files::incoming::Incoming;
use crate::process::{Group, Line};
use crate::validation::{CaptureReport, Refusal};

pub use words::{AssessReply, AssessRequest, Filming, VideoFault, VideoFaultKind};
pub use work::assess;

/// Unit in which memory is lent, in bytes.
const PIECE: u64 = 1 << 10;

/// How long a process may take to end after closing its outputs.
const LAST: Duration = Duration::from_secs(5);

/// Why an upload could not be validated.
#[derive(Debug)]
pub enum AssessError {
    /// It is no usable capture.
    Refused(Box<Refusal>),
    /// There is too little space for its content.
    NoRoom,
    /// The disk is full.
    Full,
    /// No frames could be extracted from its video.
    Video(VideoFault),
    /// The process died.
    Died {
        /// The photographs in progress, one of which may be the cause.
        names: Vec<String>,
        /// The exit status.
        status: ExitStatus,
    },
    /// One photograph took too long.
    Endless {
        /// Its name.
        name: String,
    },
    /// The whole upload took too long.
    Slow,
    /// The process could not be started or broke the protocol.
    Process(String),
}

/// The result of a validation.
#[derive(Debug, Default)]
pub struct Seen {
    /// The assessments.
    pub report: CaptureReport,
    /// A description of the frames extracted from the video.
    pub filmed: Option<String>,
}

/// Starts validation processes and lends them memory.
#[derive(Debug)]
pub struct Validators {
    command: Vec<OsString>,
    limits: Limits,
    /// Permits for concurrent processes.
    processes: Semaphore,
    /// Memory for decoding photographs, shared by all processes, in units of [`PIECE`].
    memory: Semaphore,
}

impl Validators {
    /// No process starts before the first upload.
    pub fn new(command: Vec<OsString>, limits: Limits) -> Self {
        let pieces = pieces(limits.max_decoding_bytes);
        Self {
            command,
            limits,
            processes: Semaphore::new(limits.validators),
            memory: Semaphore::new(pieces as usize),
        }
    }

    /// Validates the upload in `dir`. `turn` is held until the frames of its video are extracted.
    /// Dropping the future kills the process and then removes the folder.
    ///
    /// # Errors
    /// [`AssessError`].
    pub async fn assess(
        &self,
        dir: Arc<Incoming>,
        request: &AssessRequest,
        turn: Option<MutexGuard<'_, ()>>,
    ) -> Result<Seen, AssessError> {
        let _one_of_few = self.processes.acquire().await.map_err(closed)?;
        let mut process = Process::start(&self.command, dir)?;
        process.send(&serde_json::to_string(request).map_err(process_error)?).await?;
        Conversation {
            validators: self,
            process,
            turn,
            memory: None,
            until: Instant::now() + self.limits.assessing,
            begun: Vec::new(),
            seen: Seen::default(),
        }
        .converse()
        .await
    }
}

/// A process and its replies so far.
struct Conversation<'a> {
    validators: &'a Validators,
    process: Process,
    turn: Option<MutexGuard<'a, ()>>,
    memory: Option<SemaphorePermit<'a>>,
    /// The deadline.
    until: Instant,
    /// The photographs in progress, each with its start time.
    begun: Vec<(String, Instant)>,
    seen: Seen,
}

impl Conversation<'_> {
    async fn converse(mut self) -> Result<Seen, AssessError> {
        loop {
            let patience = self.validators.limits.photograph;
            let oldest = self.begun.iter().map(|(_, since)| *since + patience).min();
            let until = oldest.map_or(self.until, |oldest| oldest.min(self.until));
            let Ok(line) = timeout_at(until, self.process.line()).await else {
                return Err(self.late());
            };
            let Some(line) = line else {
                return Err(self.died().await);
            };
            let reply = serde_json::from_str(&line);
            let reply =
                reply.map_err(|error| process_error(format!("replied {line:?}: {error}")))?;
            if let Some(seen) = self.take(reply).await? {
                return Ok(seen);
            }
        }
    }

    /// Handles a reply; returns the result if it was the last.
    async fn take(&mut self, reply: AssessReply) -> Result<Option<Seen>, AssessError> {
        match reply {
            AssessReply::Filmed(report) => {
                self.seen.filmed = Some(report);
                self.turn = None;
            }
            AssessReply::NotFilmed(fault) => return Err(AssessError::Video(fault)),
            AssessReply::NoRoom => return Err(AssessError::NoRoom),
            AssessReply::Full => return Err(AssessError::Full),
            AssessReply::Needs(bytes) => self.lend(bytes).await?,
            AssessReply::Begins(name) => self.begun.push((name, Instant::now())),
            AssessReply::Ended(name) => {
                let at = self.begun.iter().position(|(begun, _)| *begun == name);
                at.map(|at| self.begun.swap_remove(at));
            }
            AssessReply::Image(image) => self.seen.report.images.push(image),
            AssessReply::Accepted { accepted, warnings } => {
                let mut seen = std::mem::take(&mut self.seen);
                seen.report.accepted = accepted;
                seen.report.warnings = warnings;
                return Ok(Some(seen));
            }
            AssessReply::Refused(mut refusal) => {
                refusal.report.images = std::mem::take(&mut self.seen.report.images);
                return Err(AssessError::Refused(Box::new(refusal)));
            }
        }
        Ok(None)
    }

    /// Lends memory in order of requests. A request for more than the total gets the total.
    async fn lend(&mut self, bytes: u64) -> Result<(), AssessError> {
        let limits = &self.validators.limits;
        let asked = Instant::now();
        let wanted = pieces(bytes.min(limits.max_decoding_bytes));
        let lent = self.validators.memory.acquire_many(wanted);
        self.memory = Some(lent.await.map_err(closed)?);
        // Time spent waiting for memory does not count.
        self.until += asked.elapsed();
        self.process.send(&(u64::from(wanted) * PIECE).to_string()).await
    }

    fn late(&self) -> AssessError {
        let patience = self.validators.limits.photograph;
        let is_late = |(_, since): &&(String, Instant)| since.elapsed() >= patience;
        match self.begun.iter().find(is_late) {
            Some((name, _)) => AssessError::Endless { name: name.clone() },
            None => AssessError::Slow,
        }
    }

    async fn died(mut self) -> AssessError {
        let names = self.begun.drain(..).map(|(name, _)| name).collect();
        match self.process.status().await {
            Ok(status) => AssessError::Died { names, status },
            Err(error) => process_error(error),
        }
    }
}

/// A process, and the folder that it reads and writes.
struct Process {
    inner: Option<(Group, Arc<Incoming>)>,
    /// Its last line on standard error.
    last_words: String,
}

impl Process {
    fn start(command: &[OsString], dir: Arc<Incoming>) -> Result<Self, AssessError> {
        let group = Group::spawn(command, &[], &[]);
        Ok(Self { inner: Some((group.map_err(process_error)?, dir)), last_words: String::new() })
    }

    fn group(&mut self) -> Option<&mut Group> {
        self.inner.as_mut().map(|(group, _)| group)
    }

    async fn send(&mut self, line: &str) -> Result<(), AssessError> {
        let stdin = self.group().and_then(|group| group.stdin.as_mut());
        let Some(stdin) = stdin else {
            return Err(process_error("takes no input"));
        };
        // If the process is dead, reading its output reports that.
        let _ = stdin.write_all(format!("{line}\n").as_bytes()).await;
        let _ = stdin.flush().await;
        Ok(())
    }

    /// Returns the next line of its standard output, or `None` once it has ended.
    async fn line(&mut self) -> Option<String> {
        loop {
            let (group, _) = self.inner.as_mut()?;
            match group.next_line().await? {
                Line::Output(line) => return Some(line),
                Line::Error(line) => {
                    tracing::debug!(line, "looking at an upload");
                    self.last_words = line;
                }
            }
        }
    }

    async fn status(&mut self) -> io::Result<ExitStatus> {
        let last_words = std::mem::take(&mut self.last_words);
        let group = self.group().ok_or_else(|| io::Error::other("is gone"))?;
        let status = tokio::time::timeout(LAST, group.wait()).await;
        let status = status.unwrap_or_else(|_| Err(io::Error::other("stopped responding")))?;
        tracing::warn!(%status, last_words, "a process that checked an upload died");
        Ok(status)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let (Some((mut group, dir)), Ok(runtime)) = (self.inner.take(), Handle::try_current())
        else {
            return;
        };
        runtime.spawn(async move {
            group.stop(Duration::ZERO).await;
            // Only now does no process write to the folder any more.
            drop(dir);
        });
    }
}

fn pieces(bytes: u64) -> u32 {
    u32::try_from(bytes.div_ceil(PIECE)).unwrap_or(u32::MAX)
}

fn process_error(error: impl std::fmt::Display) -> AssessError {
    AssessError::Process(error.to_string())
}

fn closed(error: tokio::sync::AcquireError) -> AssessError {
    process_error(error)
}
