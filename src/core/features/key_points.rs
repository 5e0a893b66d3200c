//! The key points of one photograph.

use super::detect::DESCRIPTOR;

/// Key points with their descriptors, best first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeyPoints {
    /// Width of the photograph, px.
    pub width: usize,
    /// Height of the photograph, px.
    pub height: usize,
    /// x and y in px; the centre of the first pixel is (0.5, 0.5).
    pub positions: Vec<[f32; 2]>,
    /// Probability of each to be found again, 0..=1.
    pub scores: Vec<f32>,
    /// [`DESCRIPTOR`] values per point, of unit length.
    pub descriptors: Vec<f32>,
}

impl KeyPoints {
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    pub(super) fn descriptor(&self, index: usize) -> &[f32; DESCRIPTOR] {
        let (descriptors, _) = self.descriptors.as_chunks();
        &descriptors[index]
    }

    /// Positions as in LighterGlue's training: relative to the middle of the photograph, in halves
    /// of its longer side, with integers at the centres of pixels.
    pub(super) fn normalised(&self) -> Vec<f32> {
        let (width, height) = (self.width as f32, self.height as f32);
        let half = 0.5 * width.max(height);
        let place =
            |[x, y]: &[f32; 2]| [(x - 0.5 - 0.5 * width) / half, (y - 0.5 - 0.5 * height) / half];
        self.positions.iter().flat_map(place).collect()
    }

    /// One vector of unit length for the whole photograph, close for photographs with the same
    /// content.
    pub(super) fn pooled(&self) -> [f32; DESCRIPTOR] {
        let mut sum = [0.0; DESCRIPTOR];
        for index in 0..self.len() {
            for (sum, value) in sum.iter_mut().zip(self.descriptor(index)) {
                *sum += self.scores[index] * value;
            }
        }
        let length = sum.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
        sum.map(|value| value / length)
    }
}
