//! From projected splats to the intersections of every tile, nearest first.

use fled_gpu::{GpuError, Kernel, Recorder, read, read_write, uniform};

use super::buffers::{SplatBuffers, VISIBLE};
use crate::splat::project::Projection;
use crate::splat::sort::{BLOCK, Counters, SCAN};

pub(super) const COUNT_VISIBLE: Kernel = Kernel::new(
    "splat/count_visible",
    &[uniform("camera"), read("spans"), read_write("block_sums")],
);
pub(super) const COMPACT_VISIBLE: Kernel = Kernel::new(
    "splat/compact_visible",
    &[
        uniform("camera"),
        read("spans"),
        read("depth_keys"),
        read("block_sums"),
        read_write("keys"),
        read_write("payloads"),
    ],
);
pub(super) const COUNT_SLOTS: Kernel = Kernel::new(
    "splat/count_slots",
    &[
        uniform("parameters"),
        read("counters"),
        read("order"),
        read("spans"),
        read_write("block_sums"),
    ],
);
pub(super) const ASSIGN_SLOTS: Kernel = Kernel::new(
    "splat/assign_slots",
    &[
        uniform("parameters"),
        read("counters"),
        read("order"),
        read("block_sums"),
        read_write("spans"),
    ],
);
pub(super) const EMIT: Kernel = Kernel::new(
    "splat/emit",
    &[
        uniform("camera"),
        uniform("parameters"),
        read("counters"),
        read("order"),
        read("projected"),
        read("spans"),
        read_write("keys"),
        read_write("payloads"),
        read_write("slot_words"),
    ],
);
pub(super) const TILE_RANGES: Kernel = Kernel::new(
    "splat/tile_ranges",
    &[
        uniform("camera"),
        uniform("parameters"),
        read("counters"),
        read("keys"),
        read_write("tile_ranges"),
        read_write("spans"),
    ],
);

/// Records all steps between projection and blending.
///
/// # Errors
/// A kernel or binding error.
pub(super) fn record(
    recorder: &mut Recorder,
    projection: &Projection,
    buffers: &SplatBuffers,
) -> Result<(), GpuError> {
    sort_by_depth(recorder, projection, buffers)?;
    assign_slots(recorder, projection, buffers)?;
    sort_by_tile(recorder, projection, buffers)
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
        &[&projection.camera, &projection.spans, &buffers.block_sums],
        blocks,
    )?;
    recorder.dispatch(
        &SCAN,
        &[&buffers.scan_visible, &counters.values, &buffers.block_sums, &counters.arguments],
        [1, 1, 1],
    )?;
    recorder.dispatch_groups(
        &COMPACT_VISIBLE,
        &[
            &projection.camera,
            &projection.spans,
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
        &[&buffers.visible, &counters.values, order, &projection.spans, &buffers.slot_sums],
        &counters.arguments,
        Counters::blocks(VISIBLE),
    )?;
    recorder.dispatch(
        &SCAN,
        &[&buffers.scan_slots, &counters.values, &buffers.slot_sums, &counters.arguments],
        [1, 1, 1],
    )?;
    recorder.dispatch_indirect(
        &ASSIGN_SLOTS,
        &[&buffers.visible, &counters.values, order, &buffers.slot_sums, &projection.spans],
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
            &projection.spans,
            buffers.tile.keys(),
            buffers.tile.payloads(),
            &buffers.slots.words,
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
            &projection.spans,
        ],
        buffers.sizes.tiles() + 1,
    )
}
