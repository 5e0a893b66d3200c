//! A child process in its own process group, so that killing it leaves nothing behind.

use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, ChildStdout, Command, ExitStatus};
use std::{fmt, io};

use rustix::process::{Pid, Signal, kill_process_group};

/// A running child and all processes that it started.
pub struct Group {
    child: Child,
    /// Set once the child is reaped: its number may then belong to another group.
    ended: Option<ExitStatus>,
}

impl fmt::Debug for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "group {}", self.child.id())
    }
}

impl Group {
    /// Starts `command` as the leader of a new group.
    ///
    /// # Errors
    /// The system's error if it cannot be started.
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        Ok(Self { child: command.process_group(0).spawn()?, ended: None })
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
        if self.ended.is_none() {
            self.ended = self.child.try_wait()?;
        }
        Ok(self.ended)
    }

    /// Waits for the leader to exit.
    ///
    /// # Errors
    /// The system's error if the status is unavailable.
    pub fn wait(&mut self) -> io::Result<ExitStatus> {
        let status = self.child.wait()?;
        self.ended = Some(status);
        Ok(status)
    }

    /// Kills the group and reaps its leader; does nothing after the leader was reaped.
    pub fn kill(&mut self) {
        let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
        if let (None, Some(pid)) = (self.ended, pid) {
            // It may have just exited; only leave nothing of it behind.
            let _ = kill_process_group(pid, Signal::KILL);
            self.ended = self.child.wait().ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::{BufRead, BufReader};
    use std::process::Stdio;
    use std::thread::sleep;
    use std::time::Duration;

    use rustix::process::kill_process;

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
    fn a_group_whose_leader_was_reaped_is_not_signalled() {
        let (mut group, child) = shell("exit");
        while group.try_wait().expect("known").is_none() {
            sleep(Duration::from_millis(5));
        }
        group.kill();
        sleep(Duration::from_millis(100));
        assert!(lives(child), "its number may have been another group's");
        kill_process(Pid::from_raw(child).expect("a number"), Signal::KILL).expect("killed");
    }
}
