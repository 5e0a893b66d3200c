//! Errors of a suite.

use std::path::{Path, PathBuf};

use fled_core::cancel::Cancelled;
use fled_core::pipeline::config::OptionsError;

/// The reason why a suite cannot run. A failed run is not an error: it is recorded, and the others
/// continue.
#[derive(Debug, thiserror::Error)]
pub enum SuiteError {
    /// The suite's file or the request is invalid.
    #[error("{0}")]
    Wrong(String),
    /// Invalid options.
    #[error("{of}: {error}")]
    Options {
        /// Their configuration and capture.
        of: String,
        error: OptionsError,
    },
    /// Reading or writing failed.
    #[error("{}: {error}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        error: std::io::Error,
    },
    /// A record contradicts its name.
    #[error("{} {detail}; remove it", path.display())]
    Record {
        /// Its file.
        path: PathBuf,
        /// The contradiction.
        detail: String,
    },
    /// An input of a run changed while it was made.
    #[error("{what} changed while a run was made of it; {} is not recorded", run.display())]
    Changed {
        /// The program, the capture or the networks.
        what: String,
        /// The run's folder.
        run: PathBuf,
    },
    /// The child process misbehaved.
    #[error("{0}")]
    Child(String),
    /// The caller cancelled the suite.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl SuiteError {
    /// Reading or writing `path` failed.
    pub fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |error| Self::Io { path, error }
    }
}
