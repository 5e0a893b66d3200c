//! Runs this program as a child process: a crash of a graphics driver ends one run but not the
//! suite.

use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration;

use fled_capture::group::{self, Group};
use fled_core::cancel::CancelToken;
use fled_lab::evaluation::suite::error::SuiteError;

use crate::failure::Failure;
use crate::tools;

/// Time between two checks of a child; runs take minutes.
const PAUSE: Duration = Duration::from_millis(100);

/// This program, with the tools that its children use.
pub struct Program {
    path: PathBuf,
    environment: Vec<(&'static str, OsString)>,
}

impl Program {
    /// The running program.
    ///
    /// # Errors
    /// [`Failure`] if its path is unknown.
    pub fn own(tools: &tools::Args) -> Result<Self, Failure> {
        let here = std::env::current_exe();
        let here = here.map_err(crate::failure::io(Path::new("fled")))?;
        Ok(Self { path: here, environment: tools.environment() })
    }

    /// The path of the program's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Runs the program with these arguments and parses its JSON output. Its exit code, which
    /// reports whether all is well, is ignored.
    ///
    /// # Errors
    /// [`SuiteError`] if the program cannot be started or prints anything else.
    pub fn asked(&self, words: &[&str]) -> Result<serde_json::Value, SuiteError> {
        let output = group::output(&mut self.command(words));
        let output = output.map_err(SuiteError::io(&self.path))?;
        serde_json::from_slice(&output.stdout).map_err(|error| {
            let message = String::from_utf8_lossy(&output.stderr);
            SuiteError::Child(format!("fled {}: {error}: {message}", words.join(" ")))
        })
    }

    /// Runs the program with these arguments to its end; if it fails, returns its last error line.
    ///
    /// # Errors
    /// [`SuiteError::Cancelled`] once the child has gone, or [`SuiteError::Io`].
    pub fn run(
        &self,
        words: &[OsString],
        cancel: &CancelToken,
    ) -> Result<Result<(), String>, SuiteError> {
        let mut command = self.command(words);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = Group::spawn(&mut command).map_err(SuiteError::io(&self.path))?;
        let (_, errors) = child.outputs();
        let reader = std::thread::spawn(move || errors.map_or(String::new(), last_error));
        let status = wait(&mut child, cancel).map_err(SuiteError::io(&self.path))?;
        cancel.check()?;
        // A reader that panicked has read nothing.
        let line = reader.join().unwrap_or_default();
        Ok(verdict(status, line))
    }

    fn command<W: AsRef<OsStr>>(&self, words: &[W]) -> Command {
        let mut command = Command::new(&self.path);
        command.args(words).envs(self.environment.iter().map(|(key, value)| (key, value)));
        command
    }
}

/// Waits for the end of a child, and terminates it on cancellation.
fn wait(child: &mut Group, cancel: &CancelToken) -> std::io::Result<ExitStatus> {
    let mut signalled = false;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if cancel.check().is_err() && !signalled {
            signalled = true;
            child.terminate();
        }
        std::thread::sleep(PAUSE);
    }
}

fn verdict(status: ExitStatus, line: String) -> Result<(), String> {
    if status.success() {
        return Ok(());
    }
    Err(if line.is_empty() { format!("ended without a message: {status}") } else { line })
}

/// The last line that reports an error, otherwise the last line.
fn last_error(errors: impl Read) -> String {
    let (mut last, mut named) = (String::new(), None);
    for line in BufReader::new(errors).split(b'\n').map_while(Result::ok) {
        let line = String::from_utf8_lossy(&line).trim().to_owned();
        let message = line.strip_prefix("fled: ");
        if let Some(message) = message.or_else(|| line.strip_prefix("error: ")) {
            named = Some(message.to_owned());
        }
        if !line.is_empty() {
            last = line;
        }
    }
    named.unwrap_or(last)
}

#[cfg(test)]
mod tests {
    use fled_core::cancel::Cancelled;

    use super::*;

    #[test]
    fn the_last_error_line_is_found() {
        let message = "   0.1 poses done\nfled: no poses\n      Take more photographs.\n\n";
        assert_eq!(last_error(message.as_bytes()), "no poses");
        let wrong_use = "error: unexpected argument\n\nFor more information, try '--help'.\n";
        assert_eq!(last_error(wrong_use.as_bytes()), "unexpected argument");
        assert_eq!(last_error(&b"a\nKilled\n"[..]), "Killed");
        assert_eq!(last_error(&b""[..]), "");
    }

    fn shell() -> Program {
        Program { path: "/bin/sh".into(), environment: vec![("FLED_COLMAP", "elsewhere".into())] }
    }

    fn words(script: &str) -> Vec<OsString> {
        vec!["-c".into(), script.into()]
    }

    #[test]
    fn a_failed_child_is_no_error_and_uses_the_suites_tools() {
        let cancel = CancelToken::new();
        let fails = words("echo fled: no $FLED_COLMAP >&2; exit 3");
        let outcome = shell().run(&fails, &cancel).expect("started");
        assert_eq!(outcome, Err("no elsewhere".to_owned()));
        let killed = shell().run(&words("kill -9 $$"), &cancel).expect("started");
        assert!(killed.is_err_and(|line| line.contains("signal: 9")));
        assert_eq!(shell().run(&words("true"), &cancel).expect("started"), Ok(()));
    }

    #[test]
    fn cancelling_the_suite_ends_its_child() {
        let cancel = CancelToken::new();
        cancel.cancel();
        let stopped = shell().run(&words("exec sleep 600"), &cancel);
        assert!(matches!(stopped, Err(SuiteError::Cancelled(Cancelled))));
    }
}
