// The reduction of shared/raster_backward.wgsl over a subgroup.
#import shared/raster_backward.wgsl
#import shared/reduce_sums.wgsl

const SUBGROUP: u32 = 8;
const PARTIALS: u32 = WIDTH / SUBGROUP;
const GROUP: u32 = 16;

fn store_partial(j: u32, lane: u32, lane_in_subgroup: u32, sums: array<f32, SUMS>) {
    let reduced = reduce_sums(lane_in_subgroup, sums);
    let part = lane / SUBGROUP;
    if (lane_in_subgroup < 8u) {
        partials[(lane_in_subgroup * PARTIALS + part) * GROUP + j] = reduced.x;
    }
    if (lane_in_subgroup == 0u) {
        partials[(8u * PARTIALS + part) * GROUP + j] = reduced.y;
    }
}
