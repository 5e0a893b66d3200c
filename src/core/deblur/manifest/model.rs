//! A network with its bytes.

use crate::deblur::Golden;
use crate::inference::digest;

/// What a network may return for values in 0..=1 when nothing else is known about it: the bounds
/// of the published NAFNets, outside which they have failed.
const USUAL_RANGE: [f32; 2] = [-1.0, 2.0];

/// A network that is ready to be loaded: checked bytes, and how to feed them.
#[derive(Clone, Debug)]
pub struct Model {
    /// Manifest id or file name.
    pub id: String,
    /// Of `bytes`.
    pub sha256: String,
    /// The ONNX file.
    pub bytes: Vec<u8>,
    /// Input channels; `None`: to be read from the file.
    pub channels: Option<u32>,
    /// Name of the input; `None`: whatever the file says.
    pub input: Option<String>,
    /// Name of the output that is the restored view; `None`: the first one.
    pub output: Option<String>,
    /// Both sides must be a multiple of this, px.
    pub multiple: usize,
    /// Least length of a side, px.
    pub minimum_side: usize,
    /// Side of a tile of large views, px.
    pub tile: usize,
    /// Least and greatest sane output for input in 0..=1.
    pub range: [f32; 2],
    /// What the self-test expects, where it is known beforehand.
    pub golden: Option<Golden>,
}

impl Model {
    /// Everything but the file.
    pub(in crate::deblur) fn without_bytes(&self) -> Self {
        Self {
            id: self.id.clone(),
            sha256: self.sha256.clone(),
            bytes: Vec::new(),
            golden: self.golden.clone(),
            input: self.input.clone(),
            output: self.output.clone(),
            ..*self
        }
    }

    /// A file about which nothing else is known.
    pub fn unknown(id: String, bytes: Vec<u8>) -> Self {
        Self {
            id,
            sha256: digest(&bytes),
            bytes,
            channels: None,
            input: None,
            output: None,
            multiple: 16,
            minimum_side: 16,
            tile: 1024,
            range: USUAL_RANGE,
            golden: None,
        }
    }
}
