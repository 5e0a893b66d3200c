// Exclusive prefix sum of the sums of blocks, in place.
// Writes the total to a counter and the indirect arguments of kernels over that many elements: six
// numbers, workgroups of a block an invocation group, then workgroups of WIDTH elements.
// Reads parameters; reads and writes counters, values [blocks]; writes arguments.
// Dispatch: 1.
#import shared/scan_values.wgsl

@group(0) @binding(0) var<uniform> parameters: SortParameters;
@group(0) @binding(1) var<storage, read_write> counters: array<u32>;
@group(0) @binding(2) var<storage, read_write> values: array<u32>;
@group(0) @binding(3) var<storage, read_write> arguments: array<u32>;

fn write_arguments(at: u32, groups: vec3<u32>) {
    arguments[at] = groups.x;
    arguments[at + 1u] = groups.y;
    arguments[at + 2u] = groups.z;
}

@compute @workgroup_size(WIDTH)
fn main(@builtin(local_invocation_index) lane: u32) {
    var count = parameters.capacity;
    if (parameters.source != FIXED) {
        count = min(count, counters[parameters.source]);
    }
    let total = scan_values(0u, (count + BLOCK - 1u) / BLOCK, lane);
    if (lane == 0u) {
        counters[parameters.result] = total;
        let cut = min(total, parameters.result_capacity);
        write_arguments(6u * parameters.result, fold_workgroups((cut + BLOCK - 1u) / BLOCK));
        write_arguments(6u * parameters.result + 3u, fold_workgroups((cut + WIDTH - 1u) / WIDTH));
    }
}
