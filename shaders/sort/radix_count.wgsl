// Counts the values of one 4-bit digit in a block of keys.
// Reads parameters, counters, keys [n]. Writes histogram [DIGITS, blocks]. Dispatch: a workgroup a
// block.
#import shared/radix.wgsl

@group(0) @binding(0) var<uniform> parameters: SortParameters;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> histogram: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_workgroup(workgroup, workgroups);
    let n = min(counters[parameters.source], parameters.capacity);
    let blocks = (n + BLOCK - 1u) / BLOCK;
    clear_digits(lane);
    let first = min(block * BLOCK + lane * ITEMS, n);
    let last = min(first + ITEMS, n);
    for (var i = first; i < last; i++) {
        digit_counts[digit_of(keys[i], parameters.shift) * WIDTH + lane] += 1u;
    }
    // All columns are complete.
    workgroupBarrier();
    if (lane < DIGITS && block < blocks) {
        var sum = 0u;
        for (var i = 0u; i < WIDTH; i++) {
            sum += digit_counts[lane * WIDTH + i];
        }
        histogram[lane * blocks + block] = sum;
    }
}
