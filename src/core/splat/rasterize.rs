//! From projected splats to an image, and from the image's gradient to the splats'.
//!
//! Forward: compact the visible splats, sort them by depth, assign slots, emit an intersection per
//! touched tile, sort by tile, find each tile's range, blend. Backward: one row of nine gradients
//! per intersection, which the projection's backward pass sums. There are no float atomics: the
//! same input gives the same bits.

mod blending;
mod buffers;
mod order;
mod slots;

use fled_gpu::{Buffer, GpuError, Kernel, Recorder};

use super::project::Projection;
pub use blending::Specialisation;
pub use buffers::{PendingCounts, SplatBuffers, SplatCounts, SplatSizes};
pub use slots::SlotRows;
#[cfg(test)]
pub(crate) use slots::gradient;

/// Numbers in the row of an intersection.
pub const SLOT_ROW: usize = 9;

/// The forward pass: from a projection to `image` and `transmittance`.
pub struct Forward {
    kernel: Kernel,
}

impl Forward {
    pub fn new(specialisation: Specialisation) -> Self {
        Self { kernel: specialisation.forward() }
    }

    /// Records all steps after the projection. `projection.camera` may be rewritten between
    /// submissions, as long as its image fits the sizes of the buffers.
    ///
    /// # Errors
    /// A kernel or binding error.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        projection: &Projection,
        buffers: &SplatBuffers,
    ) -> Result<(), GpuError> {
        order::record(recorder, projection, buffers)?;
        recorder.dispatch_groups(
            &self.kernel,
            &[
                &projection.camera,
                &buffers.tile_ranges,
                buffers.tile.sorted_payloads(),
                &buffers.slots.words,
                &projection.projected,
                &buffers.image,
                &buffers.transmittance,
            ],
            buffers.sizes.tiles(),
        )
    }
}

/// The backward pass: from the gradient of the image to a row of nine per intersection.
pub struct Backward {
    kernel: Kernel,
}

impl Backward {
    pub fn new(specialisation: Specialisation) -> Self {
        Self { kernel: specialisation.backward() }
    }

    /// Records the backward pass of a previous [`Forward::record`], for `image_gradient`, planar
    /// [3, height, width].
    ///
    /// # Errors
    /// A kernel or binding error.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        projection: &Projection,
        buffers: &SplatBuffers,
        image_gradient: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        recorder.dispatch_groups(
            &self.kernel,
            &[
                &projection.camera,
                &buffers.tile_ranges,
                buffers.tile.sorted_payloads(),
                &buffers.slots.words,
                &projection.projected,
                &buffers.image,
                image_gradient,
                &buffers.slots.colours,
                &buffers.slots.moments,
            ],
            // The additional group handles slots that belong to no tile.
            buffers.sizes.tiles() + 1,
        )
    }
}

#[cfg(test)]
mod tests;
