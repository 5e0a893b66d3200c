//! The processes that validate uploads, one for each.
//!
//! What is decoded comes from strangers, and so may crash a decoder, keep it busy for ever or make
//! it ask for all memory there is. In a process of its own, with limits, that costs its upload and
//! not the service.

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
use crate::incoming::Incoming;
use crate::jobs::process::{Group, Line};
use crate::validation::{CaptureReport, Refusal};

pub use words::{AssessReply, AssessRequest, Filming, VideoFault, VideoFaultKind};
pub use work::assess;

/// Memory is lent in pieces of so many bytes.
const PIECE: u64 = 1 << 10;

/// What has closed its outputs ends within this.
const LAST: Duration = Duration::from_secs(5);

/// Why nothing is known of an upload.
#[derive(Debug)]
pub enum AssessError {
    /// It is no usable capture.
    Refused(Box<Refusal>),
    /// There is no room for what is in it.
    NoRoom,
    /// No photographs came of its video.
    Video(VideoFault),
    /// The process died of it.
    Died {
        /// The photographs that were looked at; one of them may be why.
        names: Vec<String>,
        /// How.
        status: ExitStatus,
    },
    /// One photograph took too long.
    Endless {
        /// Which.
        name: String,
    },
    /// All of it took too long.
    Slow,
    /// There is no process, or it makes no sense.
    Process(String),
}

/// What was seen.
#[derive(Debug, Default)]
pub struct Seen {
    /// The assessments.
    pub report: CaptureReport,
    /// Which photographs were taken of the video.
    pub filmed: Option<String>,
}

/// Who starts the processes and lends them memory.
#[derive(Debug)]
pub struct Validators {
    command: Vec<OsString>,
    limits: Limits,
    /// Processes at a time.
    processes: Semaphore,
    /// Memory in which photographs are decoded, by all processes together, pieces.
    memory: Semaphore,
}

impl Validators {
    /// Nothing is started before the first upload.
    pub fn new(command: Vec<OsString>, limits: Limits) -> Self {
        let pieces = pieces(limits.max_decoding_bytes);
        Self {
            command,
            limits,
            processes: Semaphore::new(limits.validators),
            memory: Semaphore::new(pieces as usize),
        }
    }

    /// Looks at the upload in `dir`, for whose video `turn` is held until its photographs are
    /// taken. Whoever lets go of this before it is done ends the process, and the folder goes
    /// after it.
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
        process
            .send(&serde_json::to_string(request).map_err(process_error)?)
            .await?;
        Conversation {
            validators: self,
            process,
            turn,
            memory: None,
            until: Instant::now() + self.limits.assessing,
            begun: Vec::new(),
            seen: Seen::default(),
        }
        .hold()
        .await
    }
}

/// One process and what it has said so far.
struct Conversation<'a> {
    validators: &'a Validators,
    process: Process,
    turn: Option<MutexGuard<'a, ()>>,
    memory: Option<SemaphorePermit<'a>>,
    /// When its time is over.
    until: Instant,
    /// The photographs that are looked at, and since when.
    begun: Vec<(String, Instant)>,
    seen: Seen,
}

impl Conversation<'_> {
    async fn hold(mut self) -> Result<Seen, AssessError> {
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
            let reply = reply.map_err(|error| process_error(format!("says {line:?}: {error}")))?;
            if let Some(seen) = self.take(reply).await? {
                return Ok(seen);
            }
        }
    }

    /// Takes what the process says; all that was seen, when that was the last.
    async fn take(&mut self, reply: AssessReply) -> Result<Option<Seen>, AssessError> {
        match reply {
            AssessReply::Filmed(told) => {
                self.seen.filmed = Some(told);
                self.turn = None;
            }
            AssessReply::NotFilmed(fault) => return Err(AssessError::Video(fault)),
            AssessReply::NoRoom => return Err(AssessError::NoRoom),
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

    /// Lends memory, who asks first first. What is more than there is, is all of it.
    async fn lend(&mut self, bytes: u64) -> Result<(), AssessError> {
        let limits = &self.validators.limits;
        let asked = Instant::now();
        let wanted = pieces(bytes.min(limits.max_decoding_bytes));
        let lent = self.validators.memory.acquire_many(wanted);
        self.memory = Some(lent.await.map_err(closed)?);
        // Others' time is not its own.
        self.until += asked.elapsed();
        self.process
            .send(&(u64::from(wanted) * PIECE).to_string())
            .await
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
    /// What it said last on standard error.
    last_words: String,
}

impl Process {
    fn start(command: &[OsString], dir: Arc<Incoming>) -> Result<Self, AssessError> {
        let group = Group::spawn(command, &[], &[]);
        Ok(Self {
            inner: Some((group.map_err(process_error)?, dir)),
            last_words: String::new(),
        })
    }

    fn group(&mut self) -> Option<&mut Group> {
        self.inner.as_mut().map(|(group, _)| group)
    }

    async fn send(&mut self, line: &str) -> Result<(), AssessError> {
        let stdin = self.group().and_then(|group| group.stdin.as_mut());
        let Some(stdin) = stdin else {
            return Err(process_error("hears nothing"));
        };
        // What is dead by now is found so when it says nothing.
        let _ = stdin.write_all(format!("{line}\n").as_bytes()).await;
        let _ = stdin.flush().await;
        Ok(())
    }

    /// The next line of its standard output, `None` once it has ended.
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
        let status = status.unwrap_or_else(|_| Err(io::Error::other("says no more")))?;
        tracing::warn!(%status, last_words, "a process died that looked at an upload");
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
            // Only now does nobody write there any more.
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
