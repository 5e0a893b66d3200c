//! Systems without a death signal, such as macOS: a process looks for its parent now and then.
//! Linux compiles this for its tests alone.

use std::convert::Infallible;
use std::ffi::OsStr;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, ExitStatus, exit};
use std::thread::{Builder, sleep};
use std::time::Duration;

use rustix::process::{Signal, getpid, kill_process};

use super::parent::{is_parent, orphaned};

/// Time between two looks. COLMAP's end is polled as often.
const POLL: Duration = Duration::from_millis(25);

/// The offset of exit codes that stand for signals in shells.
const BY_SIGNAL: i32 = 128;

pub fn die_with(parent: &OsStr) -> io::Result<()> {
    if !is_parent(parent) {
        return Err(orphaned());
    }
    let parent = parent.to_owned();
    Builder::new().name("parent".to_owned()).spawn(move || {
        while is_parent(&parent) {
            sleep(POLL);
        }
        // Nobody is left to hear of a refusal.
        let _ = kill_process(getpid(), Signal::KILL);
    })?;
    Ok(())
}

/// Stands for the program, which ends with `parent`, and ends as it does. A watching thread would
/// not survive `exec`, so the program is a child in the same group. Returns only on failure.
pub fn become_program(parent: &OsStr, command: &mut Command) -> io::Error {
    let mut run = || -> io::Result<Infallible> {
        let is_needed = || is_parent(parent);
        if !is_needed() {
            return Err(orphaned());
        }
        end_as(attend(&mut command.spawn()?, is_needed)?)
    };
    run().map_or_else(|error| error, |never| match never {})
}

/// Waits for a child to end, and kills it once it is not needed.
fn attend(child: &mut Child, is_needed: impl Fn() -> bool) -> io::Result<ExitStatus> {
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if !is_needed() {
            child.kill()?;
            return child.wait();
        }
        sleep(POLL);
    }
}

/// Ends this process with the signal or the exit code of another.
fn end_as(status: ExitStatus) -> ! {
    let signal = status.signal();
    if let Some(signal) = signal.and_then(Signal::from_named_raw) {
        // Where the signal is ignored, the code of a shell tells it.
        let _ = kill_process(getpid(), signal);
    }
    exit(status.code().unwrap_or(BY_SIGNAL + signal.unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use rustix::process::getppid;

    use super::*;

    fn shell(script: &str) -> Child {
        Command::new("/bin/sh").args(["-c", script]).spawn().expect("started")
    }

    #[test]
    fn a_child_ends_on_its_own_while_it_is_needed() {
        let status = |script| attend(&mut shell(script), || true).expect("waited for");
        assert_eq!(status("sleep 0.1; exit 3").code(), Some(3));
        assert_eq!(status("kill -11 $$").signal(), Some(11));
    }

    #[test]
    fn a_child_is_killed_once_it_is_not_needed() {
        let start = Instant::now();
        let is_needed = || start.elapsed() < Duration::from_millis(100);
        let status = attend(&mut shell("exec sleep 60"), is_needed).expect("waited for");
        assert_eq!(status.signal(), Some(9));
        assert!(start.elapsed() < Duration::from_secs(30), "{:?}", start.elapsed());
    }

    #[test]
    fn only_the_process_that_started_this_one_is_its_parent() {
        let parent = getppid().expect("a parent").as_raw_nonzero().get().to_string();
        assert!(is_parent(parent.as_ref()));
        assert!(die_with(parent.as_ref()).is_ok());
        let own = std::process::id().to_string();
        assert!(!is_parent(own.as_ref()));
        assert!(die_with(own.as_ref()).is_err());
        let error = become_program(own.as_ref(), &mut Command::new("/bin/true"));
        assert_eq!(error.to_string(), orphaned().to_string());
    }
}
