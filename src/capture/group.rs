//! Child processes: each in its own process group, so that killing it leaves nothing behind.

mod guard;
#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

use std::io::{self, Read};
use std::process::{Command, Output, Stdio};

pub use guard::{GUARD, become_guarded, declare_guard, die_with, ending_with_this, guarded};
#[cfg(unix)]
pub use unix::Group;
#[cfg(windows)]
pub use windows::Group;

/// The variable that names the parent's process id to a child, so that it can end with its parent.
pub const PARENT_VARIABLE: &str = "FLED_PARENT_PID";

/// Runs `command` to its end and returns its output.
///
/// # Errors
/// The system's error if it cannot be started or read.
pub fn output(command: &mut Command) -> io::Result<Output> {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = Group::spawn(command)?;
    let (stdout, stderr) = child.outputs();
    let errors = std::thread::spawn(move || read(stderr));
    let stdout = read(stdout)?;
    let status = child.wait()?;
    let stderr = errors.join().unwrap_or_else(|_| Err(io::Error::other("it cannot be read")))?;
    Ok(Output { status, stdout, stderr })
}

fn read(stream: Option<impl Read>) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    stream.map_or(Ok(0), |mut stream| stream.read_to_end(&mut bytes))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_of_a_program_is_whole() {
        let mut command = Command::new("/bin/sh");
        let output = output(command.args(["-c", "echo a; echo b >&2; exit 3"])).expect("started");
        assert_eq!((&*output.stdout, &*output.stderr), (&b"a\n"[..], &b"b\n"[..]));
        assert_eq!(output.status.code(), Some(3));
        assert!(super::output(&mut Command::new("/nowhere/program")).is_err());
    }
}
