//! Errors of an evaluation.

use std::path::{Path, PathBuf};

use fled_core::cancel::Cancelled;
use fled_core::pipeline::error::{ErrorKind, PipelineError};
use fled_core::reconstruct::ReconstructError;
use fled_core::render::SplatError;

/// The reason why a run could not be judged.
#[derive(Debug, thiserror::Error)]
pub enum EvaluationError {
    /// A file of the run is missing or invalid.
    #[error("{}: {reason}", path.display())]
    Run {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The sharp photographs have no poses.
    #[error(
        "{} has no poses: it needs a COLMAP model in sparse/, a transforms.json or a \
         poses_bounds.npy",
        path.display()
    )]
    NoPoses {
        /// Their folder.
        path: PathBuf,
    },
    /// Too few of the run's training views have a pose among the sharp photographs.
    #[error(
        "{tied} of {views} training views have a pose among the sharp photographs, by the same \
         name; three tell where the others stand"
    )]
    NotTied {
        /// Views with a pose in both.
        tied: usize,
        /// Training views.
        views: usize,
    },
    /// The run's poses lack a view that it trained on.
    #[error("poses.json of the run has no lens of `{view}`, which its scene was trained on")]
    NoLens {
        /// The view.
        view: String,
    },
    /// A test view has no mask.
    #[error("{} is missing: every test view needs a mask of its name", path.display())]
    NoMask {
        /// The expected path.
        path: PathBuf,
    },
    /// A mask has no white pixel.
    #[error("the mask of `{view}` is black: there is nothing to score")]
    NothingScored {
        /// The view.
        view: String,
    },
    /// Every sharp photograph trained the scene or lies outside the training views.
    #[error("no sharp photograph is left to test on: all of them trained")]
    NoTestViews,
    /// The LPIPS network failed.
    #[error("LPIPS: {0}")]
    Lpips(String),
    /// Reading photographs or poses, or rendering, failed.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}

impl EvaluationError {
    /// An invalid file of the run.
    pub(super) fn run(path: &Path, reason: impl std::fmt::Display) -> Self {
        Self::Run { path: path.to_owned(), reason: reason.to_string() }
    }

    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Pipeline(error) => error.kind(),
            Self::Lpips(_) => ErrorKind::Environment,
            _ => ErrorKind::BadInput,
        }
    }

    /// Advice for the user.
    pub fn hint(&self) -> String {
        let hint = match self {
            Self::Pipeline(error) => return error.hint(),
            Self::Run { .. } | Self::NoLens { .. } => "Name the folder of a run that has ended.",
            Self::NoPoses { .. } => {
                "Run COLMAP on them and put its model into their folder as sparse/."
            }
            Self::NotTied { .. } => {
                "The sharp photographs must include those of the capture, named alike."
            }
            Self::NoTestViews => "Leave photographs out of the capture, or hold views out.",
            Self::NoMask { .. } | Self::NothingScored { .. } => {
                "Put a PNG of each test view there, white where it is to be scored."
            }
            Self::Lpips(_) => "Name lpips-squeeze.onnx with --lpips, or leave it away.",
        };
        hint.to_owned()
    }
}

macro_rules! through_the_pipeline {
    ($($error:ty),*) => {$(
        impl From<$error> for EvaluationError {
            fn from(error: $error) -> Self {
                Self::Pipeline(error.into())
            }
        }
    )*};
}

through_the_pipeline!(Cancelled, ReconstructError, SplatError);
