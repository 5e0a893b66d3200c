//! Child processes in separate groups, read line by line by the runtime.

use std::ffi::OsString;
use std::io;
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration;

use fled_core::group::{self, PARENT_VARIABLE};
use rustix::process::Signal;
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, BufReader};
use tokio::process::{ChildStderr, ChildStdin, ChildStdout};
use tokio::signal::unix::{self, SignalKind};
use tokio::sync::mpsc;

/// Longer lines are truncated: a runaway tool must not fill memory.
const LONGEST_LINE: u64 = 4 << 20;
/// Buffered lines; a full queue slows the child down.
const QUEUE: usize = 256;
/// The variable that marks every process of a job, including those it starts.
pub const JOB_VARIABLE: &str = "FLED_JOB_ID";
/// Prefixes of variables that hold credentials of the service. Programs that read untrusted uploads
/// must not see them.
const SECRETS: [&str; 4] = ["FLED_TOKEN", "FLED_DB", "AWS_", "PG"];

/// Asks the kernel to end this process when the server that started it ends, for whatever reason.
/// Does nothing in a process that no server started.
///
/// # Errors
/// If that server has already gone, or the kernel refuses.
pub fn die_with_parent() -> io::Result<()> {
    match std::env::var_os(PARENT_VARIABLE) {
        Some(parent) => group::die_with(&parent),
        None => Ok(()),
    }
}

/// A line of output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// From standard output.
    Output(String),
    /// From standard error.
    Error(String),
}

/// An event from a child process.
#[derive(Debug)]
pub enum Happening {
    /// It wrote a line.
    Line(Line),
    /// Both outputs are closed.
    Closed,
    /// It ended; others in its group may still write. Returned once.
    Ended(ExitStatus),
}

/// A running child and all processes it has started, without blocking the runtime.
#[derive(Debug)]
pub struct Group {
    inner: group::Group,
    /// SIGCHLD: some child has ended.
    children: unix::Signal,
    /// Whether [`Group::next`] has reported its end.
    is_reported: bool,
    /// Its standard input.
    pub stdin: Option<ChildStdin>,
    lines: mpsc::Receiver<Line>,
}

impl Group {
    /// Starts `command` in a new process group.
    ///
    /// Must be called on a runtime thread: the kernel ends children that asked for it when the
    /// *thread* that started them ends, and runtime threads live as long as the server.
    ///
    /// # Errors
    /// When the program cannot be started.
    pub fn spawn(
        command: &[OsString],
        arguments: &[OsString],
        variables: &[(&str, &str)],
    ) -> io::Result<Self> {
        let (program, first) = command
            .split_first()
            .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "empty command"))?;
        let mut command = Command::new(program);
        if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
            // Vulkan loaders look for a desktop there and report its absence as an error in the log
            // of every job.
            command.env("XDG_RUNTIME_DIR", std::env::temp_dir());
        }
        for (name, _) in std::env::vars_os() {
            let text = name.to_string_lossy();
            if SECRETS.iter().any(|secret| text.starts_with(secret)) {
                command.env_remove(name);
            }
        }
        command.args(first).args(arguments).envs(variables.iter().copied());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Before the child starts: otherwise its end could be missed.
        let children = unix::signal(SignalKind::child())?;
        let mut inner = group::Group::spawn(&mut command)?;
        let (sender, lines) = mpsc::channel(QUEUE);
        let (stdout, stderr) = inner.outputs();
        if let Some(stdout) = stdout {
            let stdout = ChildStdout::from_std(stdout)?;
            tokio::spawn(read_lines(stdout, Line::Output, sender.clone()));
        }
        if let Some(stderr) = stderr {
            tokio::spawn(read_lines(ChildStderr::from_std(stderr)?, Line::Error, sender));
        }
        let stdin = inner.input().map(ChildStdin::from_std).transpose()?;
        Ok(Self { inner, children, is_reported: false, stdin, lines })
    }

    /// The id of the process and of its group.
    pub fn pid(&self) -> i32 {
        self.inner.pid()
    }

    /// Returns the next line, or `None` once both outputs are closed. Cancel-safe.
    pub async fn next_line(&mut self) -> Option<Line> {
        self.lines.recv().await
    }

    /// Returns the next event. Cancel-safe.
    ///
    /// # Errors
    /// When the operating system does not report the exit status.
    pub async fn next(&mut self) -> io::Result<Happening> {
        tokio::select! {
            biased;
            line = self.lines.recv() => Ok(line.map_or(Happening::Closed, Happening::Line)),
            status = status_of(&mut self.inner, &mut self.children), if !self.is_reported => {
                self.is_reported = true;
                status.map(Happening::Ended)
            }
        }
    }

    /// Returns the exit status once the process (not the group) has ended. Cancel-safe.
    ///
    /// # Errors
    /// When the operating system does not report the exit status.
    pub async fn wait(&mut self) -> io::Result<ExitStatus> {
        status_of(&mut self.inner, &mut self.children).await
    }

    /// Asks the group to end, and kills all that is left of it after `grace`. Returns once the
    /// process has gone.
    pub async fn stop(&mut self, grace: Duration) {
        self.inner.terminate();
        // Whether or not the leader ended in time, the rest of its group must go.
        let _ = tokio::time::timeout(grace, self.wait()).await;
        self.inner.signal(Signal::KILL);
        if let Err(error) = self.wait().await {
            tracing::warn!(%error, pid = self.pid(), "cannot wait for a stopped process");
        }
        self.inner.kill();
    }
}

/// The exit status of a process once it has ended. Cancel-safe.
async fn status_of(
    group: &mut group::Group,
    children: &mut unix::Signal,
) -> io::Result<ExitStatus> {
    loop {
        if let Some(status) = group.try_wait()? {
            return Ok(status);
        }
        children.recv().await;
    }
}

async fn read_lines(
    source: impl AsyncRead + Unpin,
    wrap: fn(String) -> Line,
    sender: mpsc::Sender<Line>,
) {
    let mut reader = BufReader::new(source);
    let mut bytes = Vec::new();
    let mut cut = false;
    loop {
        bytes.clear();
        match (&mut reader).take(LONGEST_LINE).read_until(b'\n', &mut bytes).await {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let whole = bytes.last() == Some(&b'\n');
        // The rest of a truncated line is dropped.
        let rest = std::mem::replace(&mut cut, !whole);
        if rest {
            continue;
        }
        let text = String::from_utf8_lossy(&bytes);
        if sender.send(wrap(text.trim_end_matches(['\n', '\r']).to_owned())).await.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    fn shell(script: &str) -> Vec<OsString> {
        ["/bin/sh", "-c", script].into_iter().map(OsString::from).collect()
    }

    #[tokio::test]
    async fn both_outputs_and_the_exit_status_are_reported() {
        let mut group =
            Group::spawn(&shell("echo a; echo b >&2; exit 3"), &[], &[]).expect("start");
        let mut lines = Vec::new();
        while let Some(line) = group.next_line().await {
            lines.push(line);
        }
        assert!(
            lines.contains(&Line::Output("a".into())) && lines.contains(&Line::Error("b".into()))
        );
        assert_eq!(group.wait().await.expect("status").code(), Some(3));
    }

    #[tokio::test]
    async fn stopping_kills_grandchildren_that_ignore_sigterm() {
        let script = "trap '' TERM; sleep 60 & echo $!; wait; wait";
        let mut group = Group::spawn(&shell(script), &[], &[]).expect("start");
        let Some(Line::Output(grandchild)) = group.next_line().await else { panic!("no pid") };
        let start = Instant::now();
        group.stop(Duration::from_millis(200)).await;
        assert!(start.elapsed() < Duration::from_secs(2));
        tokio::time::sleep(Duration::from_millis(100)).await;
        let state = std::fs::read_to_string(format!("/proc/{grandchild}/stat")).unwrap_or_default();
        assert!(state.is_empty() || state.contains(") Z "), "the grandchild lives: {state}");
    }
}
