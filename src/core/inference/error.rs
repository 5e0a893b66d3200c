//! Why there is no ONNX Runtime.

use std::path::PathBuf;

/// Why ONNX Runtime cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// No usable library was found.
    #[error("the ONNX Runtime library was not found; run `make onnxruntime`. Tried: {}", tried.join("; "))]
    Missing {
        /// Each place, with what was wrong there.
        tried: Vec<String>,
    },
    /// The library was found but did not start.
    #[error("ONNX Runtime at {} did not start: {detail}", path.display())]
    Unusable {
        /// The library.
        path: PathBuf,
        /// Its own words.
        detail: String,
    },
}
