//! What an intersection passes back to its Gaussian.

use fled_gpu::{Buffer, Gpu, GpuError};

#[cfg(test)]
use super::SLOT_ROW;

/// Gradients of the intersections by what was projected. Three buffers, because one would be the first to reach what an
/// adapter binds.
#[derive(Clone)]
pub struct SlotRows {
    /// By the mean x y, px, and the opacity after the sigmoid, [intersections, 4].
    pub means: Buffer<[f32; 4]>,
    /// By the inverse covariance a b c, [intersections, 4].
    pub conics: Buffer<[f32; 4]>,
    /// By the colour, [intersections, 4].
    pub colours: Buffer<[f32; 4]>,
}

impl SlotRows {
    /// Zeroed rows.
    ///
    /// # Errors
    /// Out of memory, or above what the adapter binds.
    pub fn new(gpu: &Gpu, slots: usize) -> Result<Self, GpuError> {
        Ok(Self {
            means: gpu.create("slot means", slots)?,
            conics: gpu.create("slot conics", slots)?,
            colours: gpu.create("slot colours", slots)?,
        })
    }

    /// Rows of mean xy, conic abc, rgb, opacity.
    ///
    /// # Errors
    /// A device error.
    #[cfg(test)]
    pub(crate) fn read(&self) -> Result<Vec<f32>, GpuError> {
        let (means, conics, colours) = (self.means.read()?, self.conics.read()?, self.colours.read()?);
        let rows = means.iter().zip(&conics).zip(&colours);
        let row = |((m, conic), colour): ((&[f32; 4], &[f32; 4]), &[f32; 4])| {
            [&m[..2], &conic[..3], &colour[..3], &m[2..3]].concat()
        };
        Ok(rows.flat_map(row).collect())
    }

    /// The inverse of [`SlotRows::read`].
    ///
    /// # Errors
    /// A device error.
    #[cfg(test)]
    pub(crate) fn write(&self, rows: &[f32]) -> Result<(), GpuError> {
        let pick = |[a, b, c]: [usize; 3]| -> Vec<[f32; 4]> {
            rows.chunks_exact(SLOT_ROW).map(|row| [row[a], row[b], row[c], 0.0]).collect()
        };
        self.means.write(&pick([0, 1, 8]))?;
        self.conics.write(&pick([2, 3, 4]))?;
        self.colours.write(&pick([5, 6, 7]))
    }

    /// The most that the adapter binds.
    pub fn most(gpu: &Gpu) -> usize {
        gpu.rows_per_part(size_of::<[f32; 4]>())
    }
}
