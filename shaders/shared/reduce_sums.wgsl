// Nine sums over a subgroup of SUBGROUP lanes by shuffles: three rounds transpose eight of them
// over eight lanes while adding; wider subgroups add the eights.

// Keeps one of two sums and adds the partner's half of it: after rounds 4, 2, 1 lane i holds sum i.
fn exchange(low: f32, high: f32, upper: bool, mask: u32) -> f32 {
    let give = select(high, low, upper);
    let keep = select(low, high, upper);
    return keep + subgroupShuffleXor(give, mask);
}

// The result of lane i below 8: sum i over all lanes, and the ninth.
fn reduce_sums(lane: u32, sums: array<f32, 9>) -> vec2<f32> {
    let four = (lane & 4u) != 0u;
    let two = (lane & 2u) != 0u;
    let one = (lane & 1u) != 0u;
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
    return vec2<f32>(sum, ninth);
}
