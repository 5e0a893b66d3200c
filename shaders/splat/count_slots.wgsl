// Sums the tiles that a block of visible Gaussians touches, in order of depth.
// Reads parameters, counters, order [visible], spans [1 + count]. Writes block_sums [blocks].
// Dispatch: a workgroup a block.
#import shared/grid.wgsl
#import shared/workgroup_scan.wgsl

@group(0) @binding(0) var<uniform> parameters: SortParameters;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> block_sums: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_workgroup(workgroup, workgroups);
    let n = min(counters[parameters.source], parameters.capacity);
    let first = min(block * BLOCK + lane * ITEMS, n);
    let last = min(first + ITEMS, n);
    var sum = 0u;
    for (var i = first; i < last; i++) {
        sum += spans[1u + order[i]].y;
    }
    let scanned = workgroup_scan(sum, lane);
    if (lane == 0u && block * BLOCK < n) {
        block_sums[block] = scanned.total;
    }
}
