//! Process groups. A group is signalled only while its leader has not been reaped: afterwards the
//! kernel may reuse its number for another group.

use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use super::PARENT_VARIABLE;

/// A running child and all processes that it started. Dropping it kills them.
#[derive(Debug)]
pub struct Group {
    child: Child,
    pid: Pid,
    status: Option<ExitStatus>,
    is_reaped: bool,
}

impl Group {
    /// Starts `command` as the leader of a new group.
    ///
    /// # Errors
    /// The system's error if it cannot be started.
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        command.env(PARENT_VARIABLE, std::process::id().to_string());
        let child = command.process_group(0).spawn()?;
        let pid = Pid::from_child(&child);
        Ok(Self { child, pid, status: None, is_reaped: false })
    }

    /// The id of the leader and of the group.
    pub fn pid(&self) -> i32 {
        self.pid.as_raw_nonzero().get()
    }

    /// The pipe of its standard input; available once.
    pub fn input(&mut self) -> Option<ChildStdin> {
        self.child.stdin.take()
    }

    /// The pipes of its standard output and error; available once.
    pub fn outputs(&mut self) -> (Option<ChildStdout>, Option<ChildStderr>) {
        (self.child.stdout.take(), self.child.stderr.take())
    }

    /// The exit status of the leader, if it has exited.
    ///
    /// # Errors
    /// The system's error if the status is unavailable.
    pub fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        self.look(WaitIdOptions::NOHANG)
    }

    /// Waits for the leader to exit.
    ///
    /// # Errors
    /// The system's error if the status is unavailable.
    pub fn wait(&mut self) -> io::Result<ExitStatus> {
        let status = self.look(WaitIdOptions::empty())?;
        status.ok_or_else(|| io::Error::other("it has no exit status"))
    }

    /// Looks for the exit status without reaping the leader.
    fn look(&mut self, how: WaitIdOptions) -> io::Result<Option<ExitStatus>> {
        if self.status.is_none() {
            let how = how | WaitIdOptions::EXITED | WaitIdOptions::NOWAIT;
            self.status = waitid(WaitId::Pid(self.pid), how)?.map(|ended| {
                let code = ended.exit_status().unwrap_or_default() << 8;
                ExitStatus::from_raw(ended.terminating_signal().unwrap_or(code))
            });
        }
        Ok(self.status)
    }

    /// Asks the group to end.
    pub fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// Kills what is left of the group, and reaps its leader.
    pub fn kill(&mut self) {
        self.signal(Signal::KILL);
        if !self.is_reaped
            && let Ok(status) = self.child.wait()
        {
            self.status = Some(status);
            self.is_reaped = true;
        }
    }

    /// Signals the group.
    pub fn signal(&self, signal: Signal) {
        if !self.is_reaped {
            // An empty group is no error: all its processes have ended.
            let _ = kill_process_group(self.pid, signal);
        }
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        self.kill();
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::{BufRead, BufReader};
    use std::process::Stdio;
    use std::thread::sleep;
    use std::time::Duration;

    use super::*;

    /// A shell whose child outlives it, and the child's process id.
    fn shell(then: &str) -> (Group, i32) {
        let script = format!("sleep 60 & echo $!; {then}");
        let mut command = Command::new("/bin/sh");
        command.args(["-c", &script]).stdout(Stdio::piped());
        let mut group = Group::spawn(&mut command).expect("started");
        let mut line = String::new();
        let (output, _) = group.outputs();
        BufReader::new(output.expect("piped")).read_line(&mut line).expect("read");
        (group, line.trim().parse().expect("a number"))
    }

    fn lives(pid: i32) -> bool {
        let state = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        !state.is_empty() && !state.contains(") Z ")
    }

    #[test]
    fn a_killed_group_leaves_nothing() {
        for then in ["wait", "exit"] {
            let (mut group, child) = shell(then);
            sleep(Duration::from_millis(50));
            group.kill();
            let gone = (0..500).any(|_| {
                sleep(Duration::from_millis(10));
                !lives(child)
            });
            assert!(gone, "after {then}");
            assert!(group.try_wait().expect("known").is_some());
        }
    }

    #[test]
    fn a_group_keeps_its_number_until_its_last_signal() {
        let (mut group, child) = shell("kill -9 $$");
        let state = format!("/proc/{}/stat", group.pid());
        let state = || fs::read_to_string(&state).unwrap_or_default();
        let status = group.wait().expect("status");
        assert_eq!(status.signal(), Some(9));
        assert_eq!(group.try_wait().expect("status"), Some(status));
        assert!(state().contains(") Z "), "reaped before its group was killed: {}", state());
        assert!(lives(child));
        group.kill();
        assert_eq!(state(), "");
        group.kill();
    }
}
