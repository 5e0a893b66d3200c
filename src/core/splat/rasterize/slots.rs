//! The gradients that an intersection passes back to its Gaussian.

use fled_gpu::{Buffer, Gpu, GpuError};

#[cfg(test)]
use super::SLOT_ROW;

/// Sums over the pixels that an intersection covers, v being the derivative of the loss by the
/// exponent sigma. The gradients of the projected Gaussian follow from them with its conic and
/// opacity, which all of its intersections share. There are three buffers, because a single one
/// would be the first to reach the adapter's binding limit.
#[derive(Clone)]
pub struct SlotRows {
    /// Gradients by the colour r g b; sum of v, [intersections].
    pub colours: Buffer<[f32; 4]>,
    /// Sums of v dx, v dy, v dx^2, v dx dy, [intersections].
    pub moments: Buffer<[f32; 4]>,
    /// [2, intersections, rounded up to even]: the Gaussian; the bits of the sum of v dy^2. One
    /// buffer for both keeps the bindings of the backward pass at eight. Without gradients, the
    /// Gaussian alone.
    pub words: Buffer<u32>,
}

impl SlotRows {
    /// Zeroed rows, with or without room for gradients.
    ///
    /// # Errors
    /// Out of memory, or more than the adapter can bind.
    pub fn new(gpu: &Gpu, slots: usize, gradients: bool) -> Result<Self, GpuError> {
        let rows = if gradients { slots } else { 0 };
        // The kernels take half of the buffer's length, which is padded to 16 bytes.
        let words = if gradients { 2 * slots.next_multiple_of(2) } else { slots };
        Ok(Self {
            colours: gpu.create("slot colours", rows)?,
            moments: gpu.create("slot moments", rows)?,
            words: gpu.create("slot words", words)?,
        })
    }

    /// The rows of nine.
    ///
    /// # Errors
    /// A device error.
    #[cfg(test)]
    pub(crate) fn read(&self) -> Result<Vec<[f32; SLOT_ROW]>, GpuError> {
        let (colours, moments, words) =
            (self.colours.read()?, self.moments.read()?, self.words.read()?);
        let half = words.len() / 2;
        let row = |i: usize| {
            let ([a, b, c, d], [e, f, g, h]) = (colours[i], moments[i]);
            [a, b, c, d, e, f, g, h, f32::from_bits(words[half + i])]
        };
        Ok((0..colours.len()).map(row).collect())
    }

    /// The inverse of [`SlotRows::read`].
    ///
    /// # Errors
    /// A device error.
    #[cfg(test)]
    pub(crate) fn write(&self, rows: &[[f32; SLOT_ROW]]) -> Result<(), GpuError> {
        let (mut colours, mut moments, mut tails) = (Vec::new(), Vec::new(), Vec::new());
        for &[red, green, blue, v, vx, vy, vxx, vxy, vyy] in rows {
            colours.push([red, green, blue, v]);
            moments.push([vx, vy, vxx, vxy]);
            tails.push(vyy.to_bits());
        }
        self.colours.write(&colours)?;
        self.moments.write(&moments)?;
        self.words.write_at(self.words.len() / 2, &tails)
    }

    /// Largest number of slots that the adapter can bind.
    pub fn most(gpu: &Gpu) -> usize {
        gpu.rows_per_part(size_of::<[f32; 4]>())
    }
}

/// The gradient of a projected Gaussian from the sum of its rows.
#[cfg(test)]
pub(crate) fn gradient(
    sum: &[f64; SLOT_ROW],
    conic: [f64; 3],
    opacity: f64,
) -> crate::splat::reference::ProjectedGradient {
    let [red, green, blue, v, vx, vy, vxx, vxy, vyy] = *sum;
    let [a, b, c] = conic;
    crate::splat::reference::ProjectedGradient {
        mean: [-(a * vx + b * vy), -(b * vx + c * vy)],
        conic: [0.5 * vxx, vxy, 0.5 * vyy],
        colour: [red, green, blue],
        opacity: -v / opacity,
    }
}
