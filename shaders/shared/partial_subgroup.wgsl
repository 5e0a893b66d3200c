// The reduction of shared/raster_backward.wgsl over a subgroup by shuffles: three rounds transpose eight sums over
// eight lanes while adding, so that each lane ends with one sum; wider subgroups add the eights.
#import shared/raster_backward.wgsl

const SUBGROUP: u32 = 8;
const PARTIALS: u32 = WIDTH / SUBGROUP;

// Keeps one of two sums and adds the partner's half of it: after rounds 4, 2, 1 lane i holds sum i.
fn exchange(low: f32, high: f32, upper: bool, mask: u32) -> f32 {
    let give = select(high, low, upper);
    let keep = select(low, high, upper);
    return keep + subgroupShuffleXor(give, mask);
}

fn store_partial(j: u32, lane: u32, lane_in_subgroup: u32, sums: array<f32, SUMS>) {
    let four = (lane_in_subgroup & 4u) != 0u;
    let two = (lane_in_subgroup & 2u) != 0u;
    let one = (lane_in_subgroup & 1u) != 0u;
    let a0 = exchange(sums[0], sums[4], four, 4u);
    let a1 = exchange(sums[1], sums[5], four, 4u);
    let a2 = exchange(sums[2], sums[6], four, 4u);
    let a3 = exchange(sums[3], sums[7], four, 4u);
    let b0 = exchange(a0, a2, two, 2u);
    let b1 = exchange(a1, a3, two, 2u);
    var sum = exchange(b0, b1, one, 1u);
    var ninth = sums[8];
    for (var mask = 1u; mask < 8u; mask *= 2u) {
        ninth += subgroupShuffleXor(ninth, mask);
    }
    for (var mask = 8u; mask < SUBGROUP; mask *= 2u) {
        sum += subgroupShuffleXor(sum, mask);
        ninth += subgroupShuffleXor(ninth, mask);
    }
    let part = lane / SUBGROUP;
    if (lane_in_subgroup < 8u) {
        partials[(lane_in_subgroup * PARTIALS + part) * GROUP + j] = sum;
    }
    if (lane_in_subgroup == 0u) {
        partials[(8u * PARTIALS + part) * GROUP + j] = ninth;
    }
}
