//! Configuration of a server.

use std::ffi::OsString;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use fled_core::capture::{MAX_FILES, PHOTOGRAPH_TIME, READER_MEMORY};
use fled_core::pipeline::error::ErrorKind;

use crate::failpoint::Watcher;
use crate::store::{About, Retention};

/// Configuration of `fled serve`.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// The directory of all data that the server stores: database, captures, jobs.
    pub data: PathBuf,
    /// The shared database, `postgres://..`; if absent, the one in `data`.
    pub database: Option<String>,
    /// The shared blob store, a directory or `s3://BUCKET/PREFIX`; `data` is then only this
    /// machine's cache.
    pub files: Option<String>,
    /// What this machine reports about itself, used to assign jobs to it; if absent, it takes any
    /// job.
    pub about: Option<About>,
    /// Address to listen on; port 0 picks a free one.
    pub listen: SocketAddr,
    /// Whether it accepts other machines without any token.
    pub open: bool,
    /// Host names it accepts, besides `localhost` and IP addresses.
    pub hosts: Vec<String>,
    /// Number of jobs run in parallel.
    pub workers: usize,
    /// Program and first arguments of a job's process; the capture and the options of `fled run`
    /// follow. Every attempt runs the same command, which resumes from finished work.
    pub job_command: Vec<OsString>,
    /// Program and arguments of the process that renders novel views.
    pub render_command: Vec<OsString>,
    /// Program and arguments of the process that validates one upload.
    pub assess_command: Vec<OsString>,
    /// Program and first arguments of the process that makes a video; the result and the plan of
    /// `fled video` follow.
    pub video_command: Vec<OsString>,
    /// Program and first arguments of the process that makes a mesh; the arguments of `fled export`
    /// follow.
    pub export_command: Vec<OsString>,
    /// Program and arguments of a process that checks the machine and prints JSON, see `/readyz`.
    pub doctor_command: Vec<OsString>,
    /// Whether webhooks may point to addresses in internal networks.
    pub inner_webhooks: bool,
    /// The FFmpeg program.
    pub ffmpeg: PathBuf,
    /// Folders of networks that are not built in; child processes receive them too.
    pub models: Vec<PathBuf>,
    /// Automatic deletion.
    pub retention: Retention,
    /// Observes the failpoints of workers. Only tests set it.
    pub watcher: Option<Watcher>,
    /// Timeouts and size limits.
    pub limits: Limits,
}

impl ServeConfig {
    /// A server whose child processes run the current program.
    ///
    /// # Errors
    /// When the path of the running program is unknown.
    pub fn new(data: PathBuf, listen: SocketAddr, workers: usize) -> io::Result<Self> {
        let program = std::env::current_exe()?;
        let command = |arguments: &[&str]| {
            std::iter::once(program.clone().into_os_string())
                .chain(arguments.iter().map(OsString::from))
                .collect::<Vec<_>>()
        };
        Ok(Self {
            data,
            database: None,
            files: None,
            about: None,
            listen,
            open: false,
            hosts: Vec::new(),
            workers,
            job_command: command(&["run"]),
            render_command: command(&["render-worker"]),
            assess_command: command(&["assess-worker"]),
            video_command: command(&["video"]),
            export_command: command(&["export"]),
            doctor_command: command(&["doctor", "--json", "--no-training"]),
            inner_webhooks: false,
            ffmpeg: "ffmpeg".into(),
            models: Vec::new(),
            retention: Retention::default(),
            watcher: None,
            limits: Limits::default(),
        })
    }
}

/// Timeouts and size limits of a server. The defaults suit production; tests shorten them.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// How long a worker may be silent before it loses its job.
    pub lease: Duration,
    /// How often a worker extends its lease.
    pub heartbeat: Duration,
    /// How long a job's process may be silent before it is stopped. COLMAP's exhaustive matching of
    /// large captures is the longest known silence, some minutes.
    pub silence: Duration,
    /// Maximum run time of a job's process.
    pub wall: Duration,
    /// Time between SIGTERM and SIGKILL. Cancellation promises two seconds in total.
    pub grace: Duration,
    /// As `grace`, when the server stops and not the job: a training saves its current step.
    pub draining: Duration,
    /// How long a worker's heartbeat may fail before it ends its job, which must happen before
    /// another worker takes the job over.
    pub unheard: Duration,
    /// How often a worker publishes its job's files to a shared blob store, besides after every
    /// stage.
    pub publish: Duration,
    /// How often to poll a database that other processes change.
    pub look: Duration,
    /// Minimum time between two stored progress reports of a job.
    pub progress_interval: Duration,
    /// Wait before the first retry; each further one is four times as long.
    pub retry_base: Duration,
    /// As `retry_base`, after a disk or database error: such errors last longer.
    pub io_retry_base: Duration,
    /// Consecutive attempts without progress before a job fails.
    pub attempts_without_progress: u32,
    /// Consecutive deaths of the server, while a job ran without progress, before the job fails.
    /// More than attempts: one power cut is not the job's fault, three may be.
    pub deaths_without_progress: u32,
    /// Maximum queued jobs.
    pub queue: u32,
    /// Allowance that a client regains per second: a read request costs one, a write request ten. 0
    /// disables the limit.
    pub rate: u32,
    /// The full allowance of a client.
    pub burst: u32,
    /// Free space below which uploads and jobs are refused and no job begins, in bytes.
    pub min_free_bytes: u64,
    /// Largest upload, bytes.
    pub max_upload_bytes: u64,
    /// Maximum resumable uploads of an owner at a time: the maximum number of files in a capture.
    pub max_uploads: u32,
    /// How long after its last byte a resumable upload expires.
    pub upload_life: Duration,
    /// How long to wait for another writer when taking over a resumable upload.
    pub takeover: Duration,
    /// Maximum bytes of photographs decoded at a time, over all uploads.
    pub max_decoding_bytes: u64,
    /// Maximum validation processes at a time; further uploads wait.
    pub validators: usize,
    /// Address space of such a process, and of the one that reads a video, in bytes.
    pub assessing_bytes: u64,
    /// Maximum time to validate an upload; a video takes up to eight minutes of it.
    pub assessing: Duration,
    /// Maximum time to validate a photograph.
    pub photograph: Duration,
    /// Largest log of a job, bytes.
    pub max_log_bytes: u64,
    /// Maximum connections at a time; fewer if descriptors are scarce.
    pub connections: usize,
    /// How long the headers of a request may take, after the connection or the last request.
    pub header: Duration,
    /// How long a body or an answer may stall.
    pub stall: Duration,
    /// Longest wait for one render.
    pub render: Duration,
    /// Longest time that a mesh may take.
    pub meshing: Duration,
    /// Address space of the process that makes a mesh, in bytes.
    pub mesh_bytes: u64,
    /// Renders kept for a job.
    pub kept_renders: usize,
    /// Maximum exports and photographs from a ZIP at a time; more are refused.
    pub exports: usize,
    /// Maximum videos of a job.
    pub videos_of_job: usize,
    /// Maximum queued videos, of all jobs.
    pub videos: usize,
}

impl Limits {
    /// The duration of a lease in milliseconds.
    pub fn lease_ms(&self) -> i64 {
        i64::try_from(self.lease.as_millis()).unwrap_or(i64::MAX)
    }

    /// Milliseconds until the next attempt after this many consecutive failures without progress.
    pub fn retry_wait_ms(&self, kind: ErrorKind, failures: u32) -> i64 {
        let base = match kind {
            ErrorKind::Io => self.io_retry_base,
            _ => self.retry_base,
        };
        let base = i64::try_from(base.as_millis()).unwrap_or(i64::MAX);
        base.saturating_mul(4_i64.saturating_pow(failures.saturating_sub(1)))
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            lease: Duration::from_secs(30),
            heartbeat: Duration::from_secs(10),
            unheard: Duration::from_secs(25),
            publish: Duration::from_secs(20),
            look: Duration::from_secs(5),
            silence: Duration::from_secs(20 * 60),
            wall: Duration::from_secs(48 * 3600),
            grace: Duration::from_millis(1000),
            draining: Duration::from_secs(10),
            progress_interval: Duration::from_secs(1),
            retry_base: Duration::from_secs(2),
            io_retry_base: Duration::from_secs(60),
            attempts_without_progress: 3,
            deaths_without_progress: 5,
            queue: 200,
            rate: 50,
            burst: 1000,
            min_free_bytes: 1 << 30,
            max_upload_bytes: 8 << 30,
            max_uploads: MAX_FILES as u32,
            upload_life: Duration::from_secs(24 * 3600),
            takeover: Duration::from_secs(10),
            max_decoding_bytes: 1 << 30,
            validators: 32,
            assessing_bytes: READER_MEMORY,
            assessing: Duration::from_secs(20 * 60),
            photograph: PHOTOGRAPH_TIME,
            max_log_bytes: 32 << 20,
            connections: 1024,
            header: Duration::from_secs(30),
            stall: Duration::from_secs(30),
            render: Duration::from_secs(90),
            meshing: Duration::from_secs(300),
            mesh_bytes: 3 << 30,
            kept_renders: 400,
            exports: 4,
            videos_of_job: 20,
            videos: 50,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disk_errors_are_retried_for_minutes() {
        let limits = Limits::default();
        let all = limits.attempts_without_progress;
        let waited: i64 =
            (1..all).map(|failures| limits.retry_wait_ms(ErrorKind::Io, failures)).sum();
        assert!(waited >= 5 * 60_000, "given up after {waited} ms");
        assert_eq!(limits.retry_wait_ms(ErrorKind::Internal, 2), 8_000);
    }
}
