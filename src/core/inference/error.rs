//! Errors of loading ONNX Runtime.

use std::path::PathBuf;

/// The reason why ONNX Runtime cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// No usable library was found.
    #[error("the ONNX Runtime library was not found; run `make onnxruntime`. Tried: {}", tried.join("; "))]
    Missing {
        /// Each path tried, with the reason why it failed.
        tried: Vec<String>,
    },
    /// The library was found but did not start.
    #[error("ONNX Runtime at {} did not start: {detail}", path.display())]
    Unusable {
        /// The library.
        path: PathBuf,
        /// Its message.
        detail: String,
    },
}
