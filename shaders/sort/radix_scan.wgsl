// Exclusive prefix sum of the counts of one digit over the blocks, in place, and their total.
// Reads parameters, counters; reads and writes values [DIGITS, blocks]; writes totals [DIGITS].
// Dispatch: a workgroup a digit.
#import shared/scan_values.wgsl

@group(0) @binding(0) var<uniform> parameters: SortParameters;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read_write> values: array<u32>;
@group(0) @binding(3) var<storage, read_write> totals: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = min(counters[parameters.source], parameters.capacity);
    let blocks = (n + BLOCK - 1u) / BLOCK;
    let total = scan_values(workgroup.x * blocks, blocks, lane);
    if (lane == 0u) {
        totals[workgroup.x] = total;
    }
}
