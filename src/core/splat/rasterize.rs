//! From projected splats to an image, and from the image's gradient to the splats'.
//!
//! Forward: compact the visible splats, sort them by depth, give each its slots, emit an
//! intersection a touched tile, sort by tile, find each tile's range, blend. Backward: one row of
//! nine gradients an intersection, which the projection's backward sums. There are no atomics on
//! floats anywhere: the same input gives the same bits.

mod slots;
mod work;

use fled_gpu::{
    AdapterInfo, Buffer, DeviceType, Gpu, GpuError, Kernel, Recorder, read, read_write, uniform,
};

use super::project::Projection;
use super::sort::{BLOCK, Counters, FIXED, RadixSort, SCAN, SortParameters};
use super::uniform::TILE;
pub use slots::SlotRows;
#[cfg(test)]
pub(crate) use slots::gradient;
pub use work::SplatWork;

/// Sums of an intersection.
pub const SLOT_ROW: usize = 9;

/// Counter of visible splats.
const VISIBLE: u32 = 0;
/// Counter of intersections.
const INTERSECTIONS: u32 = 1;

const COUNT_VISIBLE: Kernel = Kernel::new(
    "splat/count_visible",
    &[
        uniform("camera"),
        read("tile_counts"),
        read_write("block_sums"),
    ],
);
const COMPACT_VISIBLE: Kernel = Kernel::new(
    "splat/compact_visible",
    &[
        uniform("camera"),
        read("tile_counts"),
        read("depth_keys"),
        read("block_sums"),
        read_write("keys"),
        read_write("payloads"),
    ],
);
const COUNT_SLOTS: Kernel = Kernel::new(
    "splat/count_slots",
    &[
        uniform("parameters"),
        read("counters"),
        read("order"),
        read("tile_counts"),
        read_write("block_sums"),
    ],
);
const ASSIGN_SLOTS: Kernel = Kernel::new(
    "splat/assign_slots",
    &[
        uniform("parameters"),
        read("counters"),
        read("order"),
        read("tile_counts"),
        read("block_sums"),
        read_write("slot_offsets"),
    ],
);
const EMIT: Kernel = Kernel::new(
    "splat/emit",
    &[
        uniform("camera"),
        uniform("parameters"),
        read("counters"),
        read("order"),
        read("projected"),
        read("tile_counts"),
        read("slot_offsets"),
        read_write("keys"),
        read_write("payloads"),
        read_write("slot_gaussian"),
    ],
);
const TILE_RANGES: Kernel = Kernel::new(
    "splat/tile_ranges",
    &[
        uniform("camera"),
        uniform("parameters"),
        read("counters"),
        read("keys"),
        read_write("tile_ranges"),
    ],
);
const FORWARD_BINDINGS: &[fled_gpu::Binding] = &[
    uniform("camera"),
    read("tile_ranges"),
    read("slots"),
    read("slot_gaussian"),
    read("projected"),
    read_write("image"),
    read_write("transmittance"),
    read_write("last"),
];
const RASTERIZE: Kernel = Kernel::new("splat/rasterize", FORWARD_BINDINGS).unchecked();
const RASTERIZE_WALK: Kernel = Kernel::new("splat/rasterize_walk", FORWARD_BINDINGS).unchecked();
const BACKWARD_BINDINGS: &[fled_gpu::Binding] = &[
    uniform("camera"),
    read("tile_ranges"),
    read("slots"),
    read("slot_gaussian"),
    read("projected"),
    read("image"),
    read("image_gradient"),
    read("last"),
    read_write("slot_colours"),
    read_write("slot_moments"),
    read_write("slot_tails"),
];
const RASTERIZE_BACKWARD: Kernel =
    Kernel::new("splat/rasterize_backward", BACKWARD_BINDINGS).unchecked();
const RASTERIZE_BACKWARD_WALK: Kernel =
    Kernel::new("splat/rasterize_backward_walk", BACKWARD_BINDINGS).unchecked();
const RASTERIZE_BACKWARD_GENERIC: Kernel =
    Kernel::new("splat/rasterize_backward_generic", BACKWARD_BINDINGS).unchecked();

/// Pixels that a subgroup blends where it walks.
const HALF_TILE: u32 = TILE * TILE / 2;

/// Which specialisation of the blending kernels runs. All give the same image to 1e-5.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Specialisation {
    /// Consecutive pixels an invocation: 4, 8 or 16.
    pub pixels: u32,
    /// Lanes of a subgroup when the backward reduces over it: 8, 16, 32 or 64; `None`: workgroup
    /// memory.
    pub subgroup: Option<u32>,
    /// Whether a subgroup blends half a tile by itself, with the splats in its registers, instead
    /// of a workgroup a tile with the splats in its memory. Needs a subgroup of 128 / `pixels`.
    pub walks: bool,
}

impl Specialisation {
    /// What suits the adapter. Software Vulkan wants few invocations with much work each (measured:
    /// the module's benchmark), a GPU many.
    pub fn for_adapter(info: &AdapterInfo) -> Self {
        let on_cpu = info.device_type == DeviceType::Cpu;
        // A subgroup's size must be known when the shader is compiled.
        let known = info
            .subgroup
            .filter(|(least, most)| least == most && *least >= 8)
            .map(|(size, _)| size);
        // Half a tile a subgroup, of vectors of four pixels.
        let walks = on_cpu && known.is_some_and(|size| matches!(size, 8 | 16 | 32));
        let pixels = match known {
            Some(size) if walks => HALF_TILE / size,
            _ if on_cpu => 16,
            _ => 4,
        };
        // It must divide the workgroup.
        let subgroup = known.filter(|size| *size <= TILE * TILE / pixels);
        Self {
            pixels,
            subgroup,
            walks,
        }
    }

    /// Splats between two reductions: as many as fit 32 KiB of workgroup memory, and at most one an
    /// invocation.
    fn group(self) -> u32 {
        let width = TILE * TILE / self.pixels;
        if self.subgroup.is_none() && width >= 64 {
            8
        } else {
            16
        }
    }

    fn forward(self) -> Kernel {
        let pixels = ("PIXELS", self.pixels);
        match self.subgroup.filter(|_| self.walks) {
            Some(size) => RASTERIZE_WALK.with(&[pixels, ("SUBGROUP", size)]),
            None => RASTERIZE.with(&[pixels]),
        }
    }

    fn backward(self) -> Kernel {
        let constants = [("PIXELS", self.pixels), ("GROUP", self.group())];
        match self.subgroup {
            Some(size) if self.walks => {
                RASTERIZE_BACKWARD_WALK.with(&[("PIXELS", self.pixels), ("SUBGROUP", size)])
            }
            Some(size) => RASTERIZE_BACKWARD
                .with(&constants)
                .with(&[("SUBGROUP", size)]),
            None => RASTERIZE_BACKWARD_GENERIC.with(&constants),
        }
    }
}

/// How much the buffers of a rasteriser hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplatSizes {
    /// Gaussians.
    pub gaussians: usize,
    /// Image width, px.
    pub width: usize,
    /// Image height, px.
    pub height: usize,
    /// Intersections of splats and tiles.
    pub intersections: usize,
}

impl SplatSizes {
    fn tiles(&self) -> usize {
        self.width.div_ceil(TILE as usize) * self.height.div_ceil(TILE as usize)
    }
}

/// How many splats were visible and how many intersections there were; exact even on overflow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplatCounts {
    /// Gaussians that touch a tile.
    pub visible: usize,
    /// Pairs of a splat and a tile it touches.
    pub intersections: usize,
    /// Room for intersections; with more, the image and the gradients are incomplete.
    pub capacity: usize,
}

impl SplatCounts {
    /// Whether intersections were dropped: grow the buffers and repeat the view.
    pub fn overflowed(&self) -> bool {
        self.intersections > self.capacity
    }
}

/// A count on its way from the device.
pub struct PendingCounts {
    values: fled_gpu::ReadBack<u32>,
    capacity: usize,
}

impl PendingCounts {
    /// Waits for the step that was submitted before the counts were asked for, for none after it.
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

/// Buffers of the rasteriser; the image may be smaller than they are.
pub struct SplatBuffers {
    sizes: SplatSizes,
    /// First slot of a Gaussian, [gaussians]; undefined where `tile_counts` is 0.
    pub slot_offsets: Buffer<u32>,
    /// Planar RGB, [3, height, width] of the camera's size.
    pub image: Buffer<f32>,
    /// What is left of the background, [height, width].
    pub transmittance: Buffer<f32>,
    /// A Gaussian's rows are `slot_offsets[g]` and the `tile_counts[g] - 1` that follow, as far as
    /// they lie below the capacity.
    pub slots: SlotRows,
    counters: Counters,
    block_sums: Buffer<u32>,
    slot_sums: Buffer<u32>,
    depth: RadixSort,
    tile: RadixSort,
    slot_gaussian: Buffer<u32>,
    tile_ranges: Buffer<[u32; 2]>,
    last: Buffer<u32>,
    scan_visible: Buffer<SortParameters>,
    scan_slots: Buffer<SortParameters>,
    visible: Buffer<SortParameters>,
    intersections: Buffer<SortParameters>,
}

impl SplatBuffers {
    /// Buffers of these sizes; without gradients when only images are wanted.
    ///
    /// # Errors
    /// Out of memory, or above what the adapter binds.
    pub fn new(gpu: &Gpu, sizes: SplatSizes, gradients: bool) -> Result<Self, GpuError> {
        let counters = Counters::new(gpu, 2)?;
        let (gaussians, slots) = (sizes.gaussians, sizes.intersections);
        let pixels = sizes.width * sizes.height;
        let tile_bits = usize::BITS - sizes.tiles().leading_zeros();
        let parameters = |source, capacity: usize, result, result_capacity: usize| {
            let (capacity, result_capacity) = (capacity as u32, result_capacity as u32);
            let row = SortParameters {
                shift: 0,
                source,
                capacity,
                result,
                result_capacity,
                per_block: 1,
            };
            gpu.upload("parameters", &[row])
        };
        Ok(Self {
            sizes,
            slot_offsets: gpu.create("slot offsets", gaussians)?,
            image: gpu.create("image", 3 * pixels)?,
            transmittance: gpu.create("transmittance", pixels)?,
            slots: SlotRows::new(gpu, if gradients { slots } else { 0 })?,
            block_sums: gpu.create("block sums", gaussians.div_ceil(BLOCK))?,
            slot_sums: gpu.create("slot sums", gaussians.div_ceil(BLOCK))?,
            depth: RadixSort::new(gpu, gaussians, 32, &counters, VISIBLE)?,
            tile: RadixSort::new(gpu, slots, tile_bits, &counters, INTERSECTIONS)?,
            slot_gaussian: gpu.create("slot gaussian", slots)?,
            tile_ranges: gpu.create("tile ranges", sizes.tiles() + 1)?,
            last: gpu.create("last", 2 * (sizes.tiles() + 1))?,
            scan_visible: parameters(FIXED, gaussians, VISIBLE, gaussians)?,
            scan_slots: parameters(VISIBLE, gaussians, INTERSECTIONS, slots)?,
            visible: parameters(VISIBLE, gaussians, VISIBLE, slots)?,
            intersections: parameters(INTERSECTIONS, slots, INTERSECTIONS, slots)?,
            counters,
        })
    }

    /// What the buffers hold.
    pub fn sizes(&self) -> SplatSizes {
        self.sizes
    }

    /// The buffer that holds the exact number of intersections, and where in it.
    pub fn totals(&self) -> (&Buffer<u32>, u32) {
        (&self.counters.values, INTERSECTIONS)
    }

    /// Starts to read the counts of the last submission back.
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
        sort_by_depth(recorder, projection, buffers)?;
        assign_slots(recorder, projection, buffers)?;
        sort_by_tile(recorder, projection, buffers)?;
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

fn sort_by_depth(
    recorder: &mut Recorder,
    projection: &Projection,
    buffers: &SplatBuffers,
) -> Result<(), GpuError> {
    let blocks = buffers.sizes.gaussians.div_ceil(BLOCK);
    let counters = &buffers.counters;
    recorder.dispatch_groups(
        &COUNT_VISIBLE,
        &[
            &projection.camera,
            &projection.tile_counts,
            &buffers.block_sums,
        ],
        blocks,
    )?;
    recorder.dispatch(
        &SCAN,
        &[
            &buffers.scan_visible,
            &counters.values,
            &buffers.block_sums,
            &counters.arguments,
        ],
        [1, 1, 1],
    )?;
    recorder.dispatch_groups(
        &COMPACT_VISIBLE,
        &[
            &projection.camera,
            &projection.tile_counts,
            &projection.depth_keys,
            &buffers.block_sums,
            buffers.depth.keys(),
            buffers.depth.payloads(),
        ],
        blocks,
    )?;
    buffers.depth.record(recorder, counters)
}

fn assign_slots(
    recorder: &mut Recorder,
    projection: &Projection,
    buffers: &SplatBuffers,
) -> Result<(), GpuError> {
    let counters = &buffers.counters;
    let order = buffers.depth.sorted_payloads();
    recorder.dispatch_indirect(
        &COUNT_SLOTS,
        &[
            &buffers.visible,
            &counters.values,
            order,
            &projection.tile_counts,
            &buffers.slot_sums,
        ],
        &counters.arguments,
        Counters::blocks(VISIBLE),
    )?;
    recorder.dispatch(
        &SCAN,
        &[
            &buffers.scan_slots,
            &counters.values,
            &buffers.slot_sums,
            &counters.arguments,
        ],
        [1, 1, 1],
    )?;
    recorder.dispatch_indirect(
        &ASSIGN_SLOTS,
        &[
            &buffers.visible,
            &counters.values,
            order,
            &projection.tile_counts,
            &buffers.slot_sums,
            &buffers.slot_offsets,
        ],
        &counters.arguments,
        Counters::blocks(VISIBLE),
    )
}

fn sort_by_tile(
    recorder: &mut Recorder,
    projection: &Projection,
    buffers: &SplatBuffers,
) -> Result<(), GpuError> {
    let counters = &buffers.counters;
    recorder.dispatch_indirect(
        &EMIT,
        &[
            &projection.camera,
            &buffers.visible,
            &counters.values,
            buffers.depth.sorted_payloads(),
            &projection.projected,
            &projection.tile_counts,
            &buffers.slot_offsets,
            buffers.tile.keys(),
            buffers.tile.payloads(),
            &buffers.slot_gaussian,
        ],
        &counters.arguments,
        Counters::elements(VISIBLE),
    )?;
    buffers.tile.record(recorder, counters)?;
    recorder.dispatch_items(
        &TILE_RANGES,
        &[
            &projection.camera,
            &buffers.intersections,
            &counters.values,
            buffers.tile.sorted_keys(),
            &buffers.tile_ranges,
        ],
        buffers.sizes.tiles() + 1,
    )
}

#[cfg(test)]
mod tests;
