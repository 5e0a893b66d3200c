// The reduction of shared/raster_backward.wgsl without subgroups: every invocation stores its own
// sums.
#import shared/raster_backward.wgsl

const PARTIALS: u32 = WIDTH;
// More would exceed 16 KiB of workgroup memory.
const GROUP: u32 = 5;

fn store_partial(j: u32, lane: u32, lane_in_subgroup: u32, sums: array<f32, SUMS>) {
    for (var i = 0u; i < SUMS; i++) {
        partials[(i * PARTIALS + lane) * GROUP + j] = sums[i];
    }
}
