//! Everything that can go wrong between a choice of network and a restored view.

use std::path::PathBuf;

use crate::inference::RuntimeError;

/// Why a network could not be loaded or run.
#[derive(Debug, thiserror::Error)]
pub enum DeblurError {
    /// There is no ONNX Runtime.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// Neither a manifest id nor a file.
    #[error("`{choice}` is no ONNX file and no known network; known are {known}")]
    UnknownModel {
        /// What was asked for.
        choice: String,
        /// Manifest ids, separated by commas.
        known: String,
    },
    /// The manifest knows the network, but its file is not here.
    #[error("the file of network {id} was not found. {advice}")]
    ModelFileMissing {
        /// Manifest id.
        id: String,
        /// Where to get it and where to put it.
        advice: String,
    },
    /// The user's list of networks is damaged.
    #[error("{}: {detail}; mend it, or remove it", path.display())]
    ManifestUnreadable {
        /// The overlay.
        path: PathBuf,
        /// What is wrong with it.
        detail: String,
    },
    /// The file could not be read.
    #[error("cannot read the network {}: {source}", path.display())]
    ModelUnreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file or the list could not be written.
    #[error("cannot keep the network at {}: {source}", path.display())]
    ModelNotKept {
        /// Where it should have gone.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not the one that the manifest names.
    #[error(
        "network {id} is damaged or another file: sha256 is {actual}, the manifest says {expected}"
    )]
    ModelChecksum {
        /// Manifest id.
        id: String,
        /// From the manifest.
        expected: String,
        /// Of the file.
        actual: String,
    },
    /// ONNX Runtime refuses the file, or its inputs and outputs are not ours.
    #[error("network {id} cannot be used: {detail}")]
    ModelUnusable {
        /// Manifest id or file name.
        id: String,
        /// What is wrong with it.
        detail: String,
    },
    /// The network loads but does not compute what it should on this machine.
    #[error("network {id} failed its self-test: {detail}")]
    SelfTest {
        /// Manifest id or file name.
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
        /// Manifest id or file name.
        id: String,
        /// Of the tile, px.
        width: usize,
        /// Of the tile, px.
        height: usize,
        /// ONNX Runtime's words.
        detail: String,
    },
}
