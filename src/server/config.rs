//! How a server is set up.

use std::ffi::OsString;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use fled_core::capture::MAX_FILES;
use fled_core::pipeline::error::ErrorKind;

use crate::failpoint::Watcher;
use crate::store::About;

/// What `fled serve` is told.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// Everything the server keeps: database, captures, jobs.
    pub data: PathBuf,
    /// The database that many machines share, `postgres://..`; the one in `data` where absent.
    pub database: Option<String>,
    /// The store of files that they share, a directory or `s3://BUCKET/PREFIX`; `data` is then only
    /// this machine's copy.
    pub files: Option<String>,
    /// What this machine says of itself to the others, and by what it is given jobs; where absent
    /// it takes any.
    pub about: Option<About>,
    /// Where it listens; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Whether it may listen to other machines although there is no token.
    pub open: bool,
    /// Names by which it may be called, besides `localhost` and addresses.
    pub hosts: Vec<String>,
    /// Jobs run at once.
    pub workers: usize,
    /// Program and first arguments of a job's process; the capture and the options of `fled run`
    /// follow. It is the same command for every attempt, and goes on from what is done.
    pub job_command: Vec<OsString>,
    /// Program and arguments of the process that renders novel views.
    pub render_command: Vec<OsString>,
    /// Program and arguments of the process that looks at one upload.
    pub assess_command: Vec<OsString>,
    /// Program and first arguments of the process that makes a video; the result and the plan of
    /// `fled video` follow.
    pub video_command: Vec<OsString>,
    /// Program and arguments of a process that judges the machine and prints JSON, see `/readyz`.
    pub doctor_command: Vec<OsString>,
    /// Whether webhooks may be at addresses of inner networks.
    pub inner_webhooks: bool,
    /// The program that reads and writes videos.
    pub ffmpeg: PathBuf,
    /// Folders of networks that are not built in; the commands are told them too.
    pub models: Vec<PathBuf>,
    /// What it deletes of itself.
    pub retention: Retention,
    /// Of the workers. Only tests have one.
    pub watcher: Option<Watcher>,
    /// Times and sizes.
    pub limits: Limits,
}

/// What the server deletes of itself; by default nothing.
#[derive(Clone, Copy, Debug)]
pub struct Retention {
    /// Jobs that ended so long ago, and captures so old that have no job.
    pub age: Option<Duration>,
    /// Jobs that ended, but the newest so many of each owner.
    pub jobs: Option<u32>,
    /// So long before something goes it says so.
    pub notice: Duration,
}

impl Retention {
    /// Whether everything is kept.
    pub fn is_off(&self) -> bool {
        self.age.is_none() && self.jobs.is_none()
    }
}

impl Default for Retention {
    fn default() -> Self {
        Self {
            age: None,
            jobs: None,
            notice: Duration::from_secs(7 * 24 * 3600),
        }
    }
}

impl ServeConfig {
    /// A server whose jobs are run by the program that runs now.
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
            doctor_command: command(&["doctor", "--json"]),
            inner_webhooks: false,
            ffmpeg: "ffmpeg".into(),
            models: Vec::new(),
            retention: Retention::default(),
            watcher: None,
            limits: Limits::default(),
        })
    }
}

/// Times and sizes of a server. The defaults suit production; tests shorten them.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// A worker that has not been heard of for so long has lost its job.
    pub lease: Duration,
    /// How often a worker extends its lease.
    pub heartbeat: Duration,
    /// A job's process that says nothing for so long is stopped. COLMAP's exhaustive matching of
    /// large captures is the longest silence known, some minutes.
    pub silence: Duration,
    /// A job's process is stopped after so long.
    pub wall: Duration,
    /// Between SIGTERM and SIGKILL. Cancelling promises two seconds in all.
    pub grace: Duration,
    /// The same where the server stops and not the job: a training saves the step that it is in.
    pub draining: Duration,
    /// A worker that could not say for so long that it lives ends its job: before others have it.
    pub unheard: Duration,
    /// How often a worker puts what its job has made into a shared store of files, besides after
    /// every stage.
    pub publish: Duration,
    /// How often somebody looks by themselves into a database that others change, too.
    pub look: Duration,
    /// Least time between two stored progress reports of a job.
    pub progress_interval: Duration,
    /// Wait before the first retry; each further one is four times as long.
    pub retry_base: Duration,
    /// The same after a fault of the disk or the database: those last longer.
    pub io_retry_base: Duration,
    /// Attempts in a row without progress before a job fails.
    pub attempts_without_progress: u32,
    /// Deaths of the server in a row, while a job ran and without progress, before the job fails.
    /// More than attempts: a power cut is not the job's fault, three may be.
    pub deaths_without_progress: u32,
    /// Jobs that may wait.
    pub queue: u32,
    /// What comes back of a client's allowance in a second: requests that read cost one, those that
    /// write ten. 0 limits nobody.
    pub rate: u32,
    /// The allowance of a client that has not asked for a while.
    pub burst: u32,
    /// Uploads and jobs are refused, and no job begins, when less free space than this is left,
    /// bytes.
    pub min_free_bytes: u64,
    /// Largest upload, bytes.
    pub max_upload_bytes: u64,
    /// Uploads in pieces that one owner may have at a time: as many as a capture may have files.
    pub max_uploads: u32,
    /// An upload in pieces goes so long after its last byte.
    pub upload_life: Duration,
    /// Who takes over an upload in pieces waits so long for whom they take it from.
    pub takeover: Duration,
    /// Photographs of all uploads that are decoded at a time, bytes.
    pub max_decoding_bytes: u64,
    /// Processes that look at uploads at a time; more uploads wait.
    pub validators: usize,
    /// Address space of such a process, and of the one that reads a video, bytes. A frame of the
    /// most pixels takes 120 MB in 10 bits, and decoders keep up to 17 and one for each thread.
    pub assessing_bytes: u64,
    /// An upload is looked at for so long at most; a video takes eight minutes of it.
    pub assessing: Duration,
    /// A photograph is looked at for so long at most. The largest take seconds.
    pub photograph: Duration,
    /// Largest log of a job, bytes.
    pub max_log_bytes: u64,
    /// Connections at a time; fewer where descriptors are few.
    pub connections: usize,
    /// A request's headers have to come within this, after the connection or the last request.
    pub header: Duration,
    /// A body has to move within this, and so has an answer.
    pub stall: Duration,
    /// Longest wait for one render.
    pub render: Duration,
    /// Renders kept for a job.
    pub kept_renders: usize,
    /// Exports that are made at a time; more are refused.
    pub exports: usize,
    /// Videos that a job may have.
    pub videos_of_job: usize,
    /// Videos that may wait, of all jobs.
    pub videos: usize,
}

impl Limits {
    /// How long a lease holds, as databases count.
    pub fn lease_ms(&self) -> i64 {
        i64::try_from(self.lease.as_millis()).unwrap_or(i64::MAX)
    }

    /// Milliseconds until the next attempt after so many failures in a row without progress.
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
            assessing_bytes: 4 << 30,
            assessing: Duration::from_secs(20 * 60),
            photograph: Duration::from_secs(120),
            max_log_bytes: 32 << 20,
            connections: 1024,
            header: Duration::from_secs(30),
            stall: Duration::from_secs(30),
            render: Duration::from_secs(90),
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
    fn a_fault_of_the_disk_is_given_minutes() {
        let limits = Limits::default();
        let all = limits.attempts_without_progress;
        let waited: i64 = (1..all)
            .map(|failures| limits.retry_wait_ms(ErrorKind::Io, failures))
            .sum();
        assert!(waited >= 5 * 60_000, "given up after {waited} ms");
        assert_eq!(limits.retry_wait_ms(ErrorKind::Internal, 2), 8_000);
    }
}
