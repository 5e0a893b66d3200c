//! Job objects, which Windows has in place of process groups. The system kills all processes of one
//! when its only handle closes, be it that this process ends.

use std::io;
use std::os::windows::io::AsRawHandle;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus};

use win32job::{ExtendedLimitInfo, Job};

use super::PARENT_VARIABLE;

/// A running child and all processes that it started. Dropping it kills them.
#[derive(Debug)]
pub struct Group {
    child: Child,
    /// `None` once it is killed.
    job: Option<Job>,
}

impl Group {
    /// Starts `command` in a new job. What it starts before it is in the job, within microseconds,
    /// is not part of it.
    ///
    /// # Errors
    /// The system's error if it cannot be started.
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        let job = Job::create_with_limit_info(ExtendedLimitInfo::new().limit_kill_on_job_close())?;
        command.env(PARENT_VARIABLE, std::process::id().to_string());
        let mut child = command.spawn()?;
        if let Err(error) = job.assign_process(child.as_raw_handle() as isize) {
            child.kill()?;
            return Err(error.into());
        }
        Ok(Self { child, job: Some(job) })
    }

    /// The pipe of its standard input; available once.
    pub fn input(&mut self) -> Option<ChildStdin> {
        self.child.stdin.take()
    }

    /// The pipes of its standard output and error; available once.
    pub fn outputs(&mut self) -> (Option<ChildStdout>, Option<ChildStderr>) {
        (self.child.stdout.take(), self.child.stderr.take())
    }

    /// The exit status of the child, if it has exited.
    ///
    /// # Errors
    /// The system's error if the status is unavailable.
    pub fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        self.child.try_wait()
    }

    /// Waits for the child to exit.
    ///
    /// # Errors
    /// The system's error if the status is unavailable.
    pub fn wait(&mut self) -> io::Result<ExitStatus> {
        self.child.wait()
    }

    /// Kills what is left of the job.
    pub fn kill(&mut self) {
        // Closes its only handle.
        self.job = None;
        // Its status stays available; there is nothing else to do about an error.
        let _ = self.child.wait();
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        self.kill();
    }
}
