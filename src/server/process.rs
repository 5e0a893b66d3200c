//! Child processes in separate groups, read line by line.
//!
//! A group is signalled only while its leader has not been reaped: afterwards the kernel may reuse
//! its number for another group.

pub mod parent_death;

use std::ffi::OsString;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, BufReader};
use tokio::process::{Child, ChildStdin, Command};
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
/// The variable that names the parent's process id to a child, so that it can end with its parent.
pub const PARENT_VARIABLE: &str = "FLED_PARENT_PID";

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

/// A running child and all processes it has started.
#[derive(Debug)]
pub struct Group {
    child: Child,
    pid: Pid,
    ends: Ends,
    /// Whether [`Group::next`] has reported its end.
    is_reported: bool,
    is_reaped: bool,
    /// Its standard input.
    pub stdin: Option<ChildStdin>,
    lines: mpsc::Receiver<Line>,
}

/// Notices the end of a child without reaping it.
#[derive(Debug)]
struct Ends {
    /// SIGCHLD: some child has ended.
    children: unix::Signal,
    status: Option<ExitStatus>,
}

impl Ends {
    /// Returns the exit status once the process has ended. Cancel-safe.
    async fn status_of(&mut self, pid: Pid) -> io::Result<ExitStatus> {
        loop {
            if let Some(status) = self.status {
                return Ok(status);
            }
            let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
            match waitid(WaitId::Pid(pid), look)? {
                Some(ended) => {
                    let signal = ended.terminating_signal();
                    let code = ended.exit_status().unwrap_or_default() << 8;
                    self.status = Some(ExitStatus::from_raw(signal.unwrap_or(code)));
                }
                None => _ = self.children.recv().await,
            }
        }
    }
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
        // Before the child starts: otherwise its end could be missed.
        let children = unix::signal(SignalKind::child())?;
        let mut child = command
            .args(first)
            .args(arguments)
            .envs(variables.iter().copied())
            .env(PARENT_VARIABLE, std::process::id().to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .kill_on_drop(true)
            .spawn()?;
        let pid = child.id().and_then(|id| Pid::from_raw(id.cast_signed()));
        let pid = pid.ok_or_else(|| io::Error::other("the process has no id"))?;
        let (sender, lines) = mpsc::channel(QUEUE);
        let (stdin, stdout, stderr) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take());
        if let Some(stdout) = stdout {
            tokio::spawn(read_lines(stdout, Line::Output, sender.clone()));
        }
        if let Some(stderr) = stderr {
            tokio::spawn(read_lines(stderr, Line::Error, sender));
        }
        let ends = Ends { children, status: None };
        Ok(Self { child, pid, ends, is_reported: false, is_reaped: false, stdin, lines })
    }

    /// The id of the process and of its group.
    pub fn pid(&self) -> i32 {
        self.pid.as_raw_nonzero().get()
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
            status = self.ends.status_of(self.pid), if !self.is_reported => {
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
        self.ends.status_of(self.pid).await
    }

    /// Asks the group to end, and kills all that is left of it after `grace`. Returns once the
    /// process has gone.
    pub async fn stop(&mut self, grace: Duration) {
        self.signal(Signal::TERM);
        // Whether or not the leader ended in time, the rest of its group must go.
        let _ = tokio::time::timeout(grace, self.wait()).await;
        self.signal(Signal::KILL);
        match self.child.wait().await {
            Ok(status) => {
                self.ends.status = Some(status);
                self.is_reaped = true;
            }
            Err(error) => {
                tracing::warn!(%error, pid = self.pid(), "cannot wait for a stopped process");
            }
        }
    }

    fn signal(&self, signal: Signal) {
        if !self.is_reaped {
            // An empty group is no error: all its processes have ended.
            let _ = kill_process_group(self.pid, signal);
        }
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        self.signal(Signal::KILL);
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

    #[tokio::test]
    async fn a_group_keeps_its_number_until_its_last_signal() {
        let script = "trap '' TERM; sleep 60 >&- 2>&- & kill -9 $$";
        let mut group = Group::spawn(&shell(script), &[], &[]).expect("start");
        let state = format!("/proc/{}/stat", group.pid());
        let state = || std::fs::read_to_string(&state).unwrap_or_default();
        let status = group.wait().await.expect("status");
        assert_eq!(status.signal(), Some(9));
        assert_eq!(group.wait().await.expect("status"), status);
        assert!(state().contains(") Z "), "reaped before its group was stopped: {}", state());
        group.stop(Duration::ZERO).await;
        assert_eq!(state(), "");
        group.stop(Duration::ZERO).await;
    }
}
