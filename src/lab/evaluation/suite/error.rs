//! Why a suite cannot be carried out.

use std::path::{Path, PathBuf};

use fled_core::cancel::Cancelled;
use fled_core::pipeline::config::OptionsError;

/// Why a suite cannot be carried out. A run that fails is none of these: it is recorded, and the
/// others go on.
#[derive(Debug, thiserror::Error)]
pub enum SuiteError {
    /// The suite's file, or what was asked of it, is wrong.
    #[error("{0}")]
    Wrong(String),
    /// Options that no run can have.
    #[error("{of}: {error}")]
    Options {
        /// The configuration and capture that have them.
        of: String,
        /// The option and what is wrong with it.
        error: OptionsError,
    },
    /// Reading or writing.
    #[error("{}: {error}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What went wrong.
        error: std::io::Error,
    },
    /// A record that cannot be what its name says.
    #[error("{} {detail}; remove it", path.display())]
    Record {
        /// Its file.
        path: PathBuf,
        /// What it is instead.
        detail: String,
    },
    /// What decides a run was another after it than before.
    #[error("{what} changed while a run was made of it; {} is not recorded", run.display())]
    Changed {
        /// Program, capture or networks.
        what: String,
        /// The run's folder.
        run: PathBuf,
    },
    /// A child did not do what the program does.
    #[error("{0}")]
    Child(String),
    /// Asked to stop.
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
