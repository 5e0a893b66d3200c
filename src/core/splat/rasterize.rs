//! From projected splats to an image, and from the image's gradient to the splats'.
//!
//! Forward: compact the visible splats, sort them by depth, give each its slots, emit an
//! intersection a touched tile, sort by tile, find each tile's range, blend. Backward: one row of
//! nine gradients an intersection, which the projection's backward sums. There are no atomics on
//! floats anywhere: the same input gives the same bits.

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

/// Sums of an intersection.
pub const SLOT_ROW: usize = 9;

/// The forward half: from a projection to `image` and `transmittance`.
pub struct Forward {
    kernel: Kernel,
}

impl Forward {
    /// The blending kernel of a specialisation.
    pub fn new(specialisation: Specialisation) -> Self {
        Self {
            kernel: specialisation.forward(),
        }
    }

    /// Adds everything after the projection. `projection.camera` may be rewritten between
    /// submissions, as long as its image fits the sizes of the buffers.
    ///
    /// # Errors
    /// A fault of a kernel or binding.
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
                &buffers.slot_gaussian,
                &projection.projected,
                &buffers.image,
                &buffers.transmittance,
                &buffers.last,
            ],
            buffers.sizes.tiles(),
        )
    }
}

/// The backward half: from the gradient of the image to a row of nine an intersection.
pub struct Backward {
    kernel: Kernel,
}

impl Backward {
    /// The kernel of a specialisation.
    pub fn new(specialisation: Specialisation) -> Self {
        Self {
            kernel: specialisation.backward(),
        }
    }

    /// Adds the backward of what [`Forward::record`] added before, for `image_gradient`, planar
    /// [3, height, width].
    ///
    /// # Errors
    /// A fault of a kernel or binding.
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
                &buffers.slot_gaussian,
                &projection.projected,
                &buffers.image,
                image_gradient,
                &buffers.last,
                &buffers.slots.colours,
                &buffers.slots.moments,
                &buffers.slots.tails,
            ],
            // One more: the slots that belong to no tile.
            buffers.sizes.tiles() + 1,
        )
    }
}

#[cfg(test)]
mod tests;
