//! Errors that end the process: message, hint, exit code.

use std::fmt;
use std::process::ExitCode;

use fled_core::event::Event;
use fled_core::pipeline::config::OptionsError;
use fled_core::pipeline::error::{ErrorKind, PipelineError};

/// An error for the user, with its exit code.
#[derive(Debug)]
pub struct Failure {
    /// The kind of failure, which decides the exit code.
    pub kind: ErrorKind,
    /// What happened.
    pub detail: String,
    /// What to do about it.
    pub hint: String,
    /// Whether the command line itself was wrong.
    pub wrong_use: bool,
}

impl Failure {
    /// The failure as an event for programs.
    pub fn event(&self) -> Event {
        Event::Failed {
            kind: self.kind.name().to_owned(),
            detail: self.detail.clone(),
            hint: self.hint.clone(),
        }
    }

    /// A failure with the advice that fits its kind.
    pub fn new(kind: ErrorKind, detail: impl fmt::Display) -> Self {
        Self { kind, detail: detail.to_string(), hint: kind.hint().to_owned(), wrong_use: false }
    }

    /// An invalid value on the command line.
    pub fn usage(detail: impl fmt::Display) -> Self {
        Self {
            kind: ErrorKind::BadInput,
            detail: detail.to_string(),
            hint: "See `fled help`.".to_owned(),
            wrong_use: true,
        }
    }

    /// Prints the failure and returns the exit code.
    pub fn report(&self) -> ExitCode {
        eprintln!("fled: {}", self.detail);
        if !self.hint.is_empty() && !self.detail.contains(&self.hint) {
            eprintln!("      {}", self.hint);
        }
        if self.wrong_use { ExitCode::from(2) } else { ExitCode::from(self.kind.exit_code()) }
    }
}

impl From<PipelineError> for Failure {
    fn from(error: PipelineError) -> Self {
        Self { kind: error.kind(), hint: error.hint(), detail: error.to_string(), wrong_use: false }
    }
}

impl From<OptionsError> for Failure {
    fn from(error: OptionsError) -> Self {
        Self::usage(error)
    }
}

/// A failure to read or write `path`.
pub fn io(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Failure {
    let path = path.to_owned();
    move |error| Failure::new(ErrorKind::Io, format!("{}: {error}", path.display()))
}
