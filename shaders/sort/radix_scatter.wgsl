// Moves the pairs of a block to their places by one 4-bit digit; stable.
// Reads parameters, counters, histogram [DIGITS, blocks] scanned, keys [n], payloads [n]. Writes
// keys_out [n], payloads_out [n]. Dispatch: a workgroup a block.
#import shared/radix.wgsl

@group(0) @binding(0) var<uniform> parameters: SortParameters;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> histogram: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<u32>;
@group(0) @binding(4) var<storage, read> payloads: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> payloads_out: array<u32>;

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
        var place = histogram[lane * blocks + block];
        for (var i = 0u; i < WIDTH; i++) {
            let count = digit_counts[lane * WIDTH + i];
            digit_counts[lane * WIDTH + i] = place;
            place += count;
        }
    }
    // Every invocation finds where its first key of each digit goes.
    workgroupBarrier();
    for (var i = first; i < last; i++) {
        let key = keys[i];
        let at = digit_of(key, parameters.shift) * WIDTH + lane;
        let place = digit_counts[at];
        digit_counts[at] = place + 1u;
        keys_out[place] = key;
        payloads_out[place] = payloads[i];
    }
}
