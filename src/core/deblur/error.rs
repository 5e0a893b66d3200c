//! Errors of choosing, loading and running a network.

use std::path::PathBuf;

use crate::inference::RuntimeError;

/// The reason why a network could not be loaded or run.
#[derive(Debug, thiserror::Error)]
pub enum DeblurError {
    /// ONNX Runtime is missing.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The choice is neither the built-in network nor a file.
    #[error("`{choice}` is neither an ONNX file nor a known network; known networks are {known}")]
    UnknownModel {
        /// The value of the option.
        choice: String,
        /// Names of networks, separated by commas.
        known: String,
    },
    /// The file could not be read.
    #[error("cannot read the network {}: {source}", path.display())]
    ModelUnreadable {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// ONNX Runtime rejects the file, or its inputs and outputs do not fit.
    #[error("network {id} cannot be used: {detail}")]
    ModelUnusable {
        /// The built-in network's id, or a file name.
        id: String,
        /// The reason.
        detail: String,
    },
    /// The network loads but computes wrong values on this machine.
    #[error("network {id} failed its self-test: {detail}")]
    SelfTest {
        /// The built-in network's id, or a file name.
        id: String,
        /// The deviation.
        detail: String,
    },
    /// View and guide differ in size.
    #[error("a view of {}x{} cannot be guided by a render of {}x{}", blurry.0, blurry.1, guide.0, guide.1)]
    GuideSize {
        /// Width and height of the view, px.
        blurry: (usize, usize),
        /// Width and height of the guide, px.
        guide: (usize, usize),
    },
    /// Running the network failed.
    #[error("network {id} failed on {width}x{height} px: {detail}")]
    Inference {
        /// The built-in network's id, or a file name.
        id: String,
        /// Width of the tile, px.
        width: usize,
        /// Height of the tile, px.
        height: usize,
        /// ONNX Runtime's message.
        detail: String,
    },
}
