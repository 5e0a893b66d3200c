//! The rasteriser's buffers, and the counts of an image.

use fled_gpu::{Buffer, Gpu, GpuError, ReadBack};

use super::SlotRows;
use crate::splat::sort::{BLOCK, Counters, FIXED, RadixSort, SortParameters};
use crate::splat::uniform::TILE;

/// Counter of visible splats.
pub(super) const VISIBLE: u32 = 0;
/// Counter of intersections.
pub(super) const INTERSECTIONS: u32 = 1;

/// The sizes of a rasteriser's buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplatSizes {
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Image width, px.
    pub width: usize,
    /// Image height, px.
    pub height: usize,
    /// Number of intersections of splats and tiles.
    pub intersections: usize,
}

impl SplatSizes {
    pub(super) fn tiles(&self) -> usize {
        self.width.div_ceil(TILE as usize) * self.height.div_ceil(TILE as usize)
    }
}

/// The numbers of visible splats and of intersections; exact even on overflow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplatCounts {
    /// Number of Gaussians that touch a tile.
    pub visible: usize,
    /// Number of pairs of a splat and a tile that it touches.
    pub intersections: usize,
    /// Room for intersections; with more, the image and the gradients are incomplete.
    pub capacity: usize,
}

impl SplatCounts {
    /// Whether intersections were dropped; the caller grows the buffers and repeats the view.
    pub fn overflowed(&self) -> bool {
        self.intersections > self.capacity
    }
}

/// Counts that are being read back from the device.
pub struct PendingCounts {
    values: ReadBack<u32>,
    capacity: usize,
}

impl PendingCounts {
    /// Waits for the step submitted before the read-back began, but for none after it.
    ///
    /// # Errors
    /// A device error.
    pub fn wait(self) -> Result<SplatCounts, GpuError> {
        let values = self.values.wait()?;
        let at = |index: u32| values[index as usize] as usize;
        Ok(SplatCounts {
            visible: at(VISIBLE),
            intersections: at(INTERSECTIONS),
            capacity: self.capacity,
        })
    }
}

/// Buffers of the rasteriser; the image may be smaller.
pub struct SplatBuffers {
    pub(super) sizes: SplatSizes,
    /// Planar RGB, [3, height, width] of the camera's size.
    pub image: Buffer<f32>,
    /// Remaining share of the background, [height, width].
    pub transmittance: Buffer<f32>,
    /// The rows of a Gaussian are those of its span, as far as they are below the capacity.
    pub slots: SlotRows,
    pub(super) counters: Counters,
    pub(super) block_sums: Buffer<u32>,
    pub(super) slot_sums: Buffer<u32>,
    pub(super) depth: RadixSort,
    pub(super) tile: RadixSort,
    pub(super) tile_ranges: Buffer<[u32; 3]>,
    pub(super) scan_visible: Buffer<SortParameters>,
    pub(super) scan_slots: Buffer<SortParameters>,
    pub(super) visible: Buffer<SortParameters>,
    pub(super) intersections: Buffer<SortParameters>,
}

impl SplatBuffers {
    /// Buffers of these sizes, with or without room for gradients.
    ///
    /// # Errors
    /// Out of memory, or more than the adapter can bind.
    pub fn new(gpu: &Gpu, sizes: SplatSizes, gradients: bool) -> Result<Self, GpuError> {
        let counters = Counters::new(gpu, 2)?;
        let (gaussians, slots) = (sizes.gaussians, sizes.intersections);
        let pixels = sizes.width * sizes.height;
        let tile_bits = usize::BITS - sizes.tiles().leading_zeros();
        let parameters = |source, capacity: usize, result, result_capacity: usize| {
            let (capacity, result_capacity) = (capacity as u32, result_capacity as u32);
            let row = SortParameters { shift: 0, source, capacity, result, result_capacity };
            gpu.upload("parameters", &[row])
        };
        Ok(Self {
            sizes,
            image: gpu.create("image", 3 * pixels)?,
            transmittance: gpu.create("transmittance", pixels)?,
            slots: SlotRows::new(gpu, slots, gradients)?,
            block_sums: gpu.create("block sums", gaussians.div_ceil(BLOCK))?,
            slot_sums: gpu.create("slot sums", gaussians.div_ceil(BLOCK))?,
            depth: RadixSort::new(gpu, gaussians, 32, VISIBLE)?,
            tile: RadixSort::new(gpu, slots, tile_bits, INTERSECTIONS)?,
            tile_ranges: gpu.create("tile ranges", sizes.tiles() + 1)?,
            scan_visible: parameters(FIXED, gaussians, VISIBLE, gaussians)?,
            scan_slots: parameters(VISIBLE, gaussians, INTERSECTIONS, slots)?,
            visible: parameters(VISIBLE, gaussians, VISIBLE, slots)?,
            intersections: parameters(INTERSECTIONS, slots, INTERSECTIONS, slots)?,
            counters,
        })
    }

    /// Buffers of other sizes, with the same counters.
    ///
    /// # Errors
    /// As [`SplatBuffers::new`].
    pub fn resized(&self, gpu: &Gpu, sizes: SplatSizes, gradients: bool) -> Result<Self, GpuError> {
        Ok(Self { counters: self.counters.clone(), ..Self::new(gpu, sizes, gradients)? })
    }

    pub fn sizes(&self) -> SplatSizes {
        self.sizes
    }

    /// The buffer with the exact number of intersections, and its index there.
    pub fn totals(&self) -> (&Buffer<u32>, u32) {
        (&self.counters.values, INTERSECTIONS)
    }

    /// Starts reading back the counts of the last submission.
    ///
    /// # Errors
    /// A device error.
    pub fn counts(&self) -> Result<PendingCounts, GpuError> {
        Ok(PendingCounts {
            values: self.counters.values.start_read(2)?,
            capacity: self.sizes.intersections,
        })
    }
}
