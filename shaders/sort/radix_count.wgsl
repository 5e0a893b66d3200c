// Counts the values of one 8-bit digit in a block of keys.
// Reads parameters, counters, keys [n]. Writes histogram [DIGITS, blocks]. Dispatch: a workgroup a
// block.
#import shared/radix.wgsl

@group(0) @binding(0) var<uniform> parameters: SortParameters;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> histogram: array<u32>;

var<workgroup> counts: array<atomic<u32>, DIGITS>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_workgroup(workgroup, workgroups);
    let n = min(counters[parameters.source], parameters.capacity);
    let blocks = (n + BLOCK - 1u) / BLOCK;
    for (var digit = lane; digit < DIGITS; digit += WIDTH) {
        atomicStore(&counts[digit], 0u);
    }
    // All counts are 0.
    workgroupBarrier();
    let last = min(block * BLOCK + BLOCK, n);
    for (var i = block * BLOCK + lane; i < last; i += WIDTH) {
        atomicAdd(&counts[digit_of(keys[i], parameters.shift)], 1u);
    }
    // All keys are counted.
    workgroupBarrier();
    if (block < blocks) {
        for (var digit = lane; digit < DIGITS; digit += WIDTH) {
            histogram[digit * blocks + block] = atomicLoad(&counts[digit]);
        }
    }
}
