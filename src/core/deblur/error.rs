//! Everything that can go wrong between a choice of network and a restored view.

use std::path::PathBuf;

use crate::inference::RuntimeError;

/// Why a network could not be loaded or run.
#[derive(Debug, thiserror::Error)]
pub enum DeblurError {
    /// There is no ONNX Runtime.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// Neither the built-in network nor a file.
    #[error("`{choice}` is no ONNX file and no known network; known are {known}")]
    UnknownModel {
        /// What was asked for.
        choice: String,
        /// Names of networks, separated by commas.
        known: String,
    },
    /// The file could not be read.
    #[error("cannot read the network {}: {source}", path.display())]
    ModelUnreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// ONNX Runtime refuses the file, or its inputs and outputs are not ours.
    #[error("network {id} cannot be used: {detail}")]
    ModelUnusable {
        /// The built-in network's id, or a file name.
        id: String,
        /// What is wrong with it.
        detail: String,
    },
    /// The network loads but does not compute what it should on this machine.
    #[error("network {id} failed its self-test: {detail}")]
    SelfTest {
        /// The built-in network's id, or a file name.
        id: String,
        /// What was seen.
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
        /// Of the tile, px.
        width: usize,
        /// Of the tile, px.
        height: usize,
        /// ONNX Runtime's words.
        detail: String,
    },
}
