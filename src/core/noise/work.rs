//! How much a step of the field has to do, for whoever relates its time to it.

use super::NoiseField;

/// What the network sees in one step.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NoiseWork {
    /// Pixels of the image.
    pub pixels: usize,
    /// Cells the network is asked about: one in 64 pixels, or every pixel.
    pub cells: usize,
    /// Parts the cells are taken in. With more than one the forward runs twice, for want of kept
    /// activations.
    pub chunks: usize,
    /// Parts of the cells whose weight gradients are summed apart.
    pub segments: usize,
    /// Numbers of all weights and biases, filled up to multiples of 4.
    pub parameters: usize,
    /// Inputs and outputs of each layer, filled up to multiples of 4.
    pub layers: Vec<[usize; 2]>,
}

impl NoiseField {
    /// The work of the view of the last [`NoiseField::begin_step`].
    pub fn work(&self) -> NoiseWork {
        NoiseWork {
            pixels: self.current.pixels(),
            cells: self.current.cells(),
            chunks: self.chunks().len(),
            segments: self.segments as usize,
            parameters: 4 * self.network.parameters(),
            layers: self
                .network
                .layers
                .iter()
                .map(|l| [4 * l.inputs4, 4 * l.outputs4])
                .collect(),
        }
    }
}
