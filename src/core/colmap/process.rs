//! One COLMAP command: in its own process group, limited in time and log size, killed on
//! cancellation and when this process dies.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use crate::cancel::CancelToken;
use crate::group::Group;
use crate::poses::PosesError;

/// Polling interval of a running command: a cancellation takes effect within two of these.
const POLL: Duration = Duration::from_millis(25);

/// Maximum size of `colmap.log`, bytes. COLMAP writes ~100 bytes per photograph and step; a broken
/// one may write endlessly.
const LOG_BYTES: u64 = 8 << 20;

/// Bytes of a command's output kept in memory: `-h` of the longest command is 6 KB.
const TAIL_BYTES: usize = 64 << 10;

/// Time limits for one COLMAP command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Total.
    pub wall: Duration,
    /// Without output. Matching a block of 50 photographs on a slow machine is silent for minutes.
    pub silence: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self { wall: Duration::from_secs(4 * 3600), silence: Duration::from_secs(20 * 60) }
    }
}

/// Runs one program's subcommands.
#[derive(Debug)]
pub(super) struct Runner {
    program: PathBuf,
    limits: Limits,
    log: Option<Mutex<Log>>,
    /// The command that starts the program in a process that ends with this one; empty if there
    /// is none.
    guarded: Vec<OsString>,
}

/// A file that stops growing at [`LOG_BYTES`] with a note.
#[derive(Debug)]
struct Log {
    file: File,
    left: u64,
}

impl Log {
    /// The log is only for later reading: a full disk must not change the outcome here; writing the
    /// artifacts reports it.
    fn write(&mut self, bytes: &[u8]) {
        if self.left == 0 {
            return;
        }
        let fits = bytes.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
        let _ = self.file.write_all(&bytes[..fits]);
        self.left -= fits as u64;
        if self.left == 0 {
            let _ = self.file.write_all(b"\n[log cut here]\n");
        }
    }
}

/// A command that exited on its own.
#[derive(Debug)]
pub(super) struct Finished {
    pub status: ExitStatus,
    tail: VecDeque<u8>,
}

impl Finished {
    /// The output, standard output and error interleaved, at most the last 64 KiB.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.tail.iter().copied().collect::<Vec<_>>()).into_owned()
    }

    /// The error for this exit status.
    pub fn failure(&self, command: &str) -> PosesError {
        let text = self.text();
        let lines: Vec<&str> = text.lines().filter_map(message).collect();
        let tail = lines[lines.len().saturating_sub(5)..].join(" | ");
        let tail = if tail.is_empty() { "it gave no message".to_owned() } else { tail };
        PosesError::Tool { command: command.to_owned(), status: self.status.to_string(), tail }
    }
}

impl Runner {
    /// A runner of `program`, started by `guarded` unless that is empty, with its output written to
    /// `log`.
    pub fn new(
        program: &Path,
        guarded: &[OsString],
        limits: Limits,
        log: Option<&Path>,
    ) -> Result<Self, PosesError> {
        let open = |path: &Path| {
            let file = File::create(path).map_err(PosesError::io(path))?;
            Ok::<_, PosesError>(Mutex::new(Log { file, left: LOG_BYTES }))
        };
        Ok(Self {
            program: program.to_owned(),
            guarded: guarded.to_vec(),
            limits,
            log: log.map(open).transpose()?,
        })
    }

    /// Writes our own line to the log.
    pub fn note(&self, line: &str) {
        self.log_bytes(format!("{line}\n").as_bytes());
    }

    fn log_bytes(&self, bytes: &[u8]) {
        if let Some(log) = &self.log {
            log.lock().unwrap_or_else(std::sync::PoisonError::into_inner).write(bytes);
        }
    }

    /// Runs `program command arguments` until it exits, successfully or not.
    ///
    /// # Errors
    /// [`PosesError::Missing`], [`PosesError::Timeout`], [`PosesError::Cancelled`]. In the last two
    /// cases the whole process group has been killed and reaped.
    pub fn run(
        &self,
        command: &str,
        arguments: &[String],
        cancel: &CancelToken,
    ) -> Result<Finished, PosesError> {
        cancel.check()?;
        self.note(&format!("$ colmap {command} {}", arguments.join(" ")));
        let mut child = self.spawn(command, arguments)?;
        let output = read_output(&mut child);
        let outcome = self.watch(command, &mut child, &output, cancel);
        if outcome.is_err() {
            child.kill();
        }
        outcome
    }

    fn spawn(&self, command: &str, arguments: &[String]) -> Result<Group, PosesError> {
        let missing = |source: std::io::Error| PosesError::Missing {
            program: self.program.display().to_string(),
            reason: source.to_string(),
        };
        // `help` runs first and directly, so a missing program gives the system's own error.
        let mut process = match self.guarded.split_first() {
            Some((guard, arguments)) if command != "help" => {
                let mut process = Command::new(guard);
                process.args(arguments);
                process
            }
            _ => Command::new(&self.program),
        };
        process.arg(command).args(arguments).env("QT_QPA_PLATFORM", "offscreen");
        process.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Group::spawn(&mut process).map_err(missing)
    }

    /// Watches the child until it exits.
    fn watch(
        &self,
        command: &str,
        child: &mut Group,
        output: &Receiver<Vec<u8>>,
        cancel: &CancelToken,
    ) -> Result<Finished, PosesError> {
        let start = Instant::now();
        let mut heard = start;
        let mut tail = VecDeque::new();
        let timeout = |limit: Duration, why| PosesError::Timeout {
            command: command.to_owned(),
            seconds: limit.as_secs(),
            why,
        };
        let failed = PosesError::io(&self.program);
        loop {
            cancel.check()?;
            match output.recv_timeout(POLL) {
                Ok(bytes) => {
                    heard = Instant::now();
                    self.log_bytes(&bytes);
                    keep(&mut tail, &bytes);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(POLL),
            }
            if start.elapsed() > self.limits.wall {
                return Err(timeout(self.limits.wall, "in all"));
            }
            if heard.elapsed() > self.limits.silence {
                return Err(timeout(self.limits.silence, "without output"));
            }
            match child.try_wait() {
                Ok(Some(status)) => {
                    self.drain(output, &mut tail);
                    return Ok(Finished { status, tail });
                }
                Ok(None) => {}
                Err(source) => return Err(failed(source)),
            }
        }
    }

    /// The output written before the exit and not yet read. Limited in time, because a grandchild
    /// that left the group could hold the pipe open.
    fn drain(&self, output: &Receiver<Vec<u8>>, tail: &mut VecDeque<u8>) {
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(1) {
            match output.recv_timeout(POLL) {
                Ok(bytes) => {
                    self.log_bytes(&bytes);
                    keep(tail, &bytes);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }
}

/// The message in a line of output, without the prefix of the glog library; `None` for a line
/// without words and for stack traces.
fn message(line: &str) -> Option<&str> {
    let line = line.trim();
    let has_words = line.contains(char::is_alphanumeric);
    let is_trace = !has_words || line.starts_with("@ ") || line.starts_with("***");
    let is_logged = line.starts_with(['I', 'W', 'E', 'F'])
        && line[1..].starts_with(|c: char| c.is_ascii_digit());
    match line.split_once("] ") {
        _ if is_trace => None,
        Some((_, message)) if is_logged => Some(message),
        _ => Some(line),
    }
}

fn keep(tail: &mut VecDeque<u8>, bytes: &[u8]) {
    tail.extend(bytes);
    let excess = tail.len().saturating_sub(TAIL_BYTES);
    tail.drain(..excess);
}

/// Both streams through one bounded channel. The readers end when the pipes close.
fn read_output(child: &mut Group) -> Receiver<Vec<u8>> {
    fn forward(stream: Option<impl Read + Send + 'static>, sender: SyncSender<Vec<u8>>) {
        let Some(mut stream) = stream else { return };
        std::thread::spawn(move || {
            let mut buffer = [0; 8192];
            while let Ok(count @ 1..) = stream.read(&mut buffer) {
                if sender.send(buffer[..count].to_vec()).is_err() {
                    return;
                }
            }
        });
    }
    let (sender, receiver) = sync_channel(16);
    let (stdout, stderr) = child.outputs();
    forward(stdout, sender.clone());
    forward(stderr, sender);
    receiver
}

#[cfg(test)]
mod tests {
    use super::message;

    #[test]
    fn stack_traces_and_log_prefixes_are_left_out_of_errors() {
        let text = "F0503 12:00:00.000000  77 sift.cc:12] Check failed: size > 0\n\
                    *** Check failure stack trace: ***\n    @     0x7f00 google::LogMessage::Fail()\n\n====\n\
                    [mapper] Images: 3";
        let messages: Vec<&str> = text.lines().filter_map(message).collect();
        assert_eq!(messages, ["Check failed: size > 0", "[mapper] Images: 3"]);
    }
}
