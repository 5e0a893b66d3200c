// Gives every visible Gaussian its first slot: a prefix sum of tile counts in order of depth.
// Reads parameters, counters, order [visible], block_sums [blocks] scanned. Of spans [1 + count] it
// reads the numbers of tiles and writes the first slots, for visible Gaussians only.
// Dispatch: a workgroup a block.
#import shared/grid.wgsl
#import shared/workgroup_scan.wgsl

@group(0) @binding(0) var<uniform> parameters: SortParameters;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> block_sums: array<u32>;
@group(0) @binding(4) var<storage, read_write> spans: array<vec2<u32>>;

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
    if (first >= last) {
        return;
    }
    var slot = block_sums[block] + scanned.before;
    for (var i = first; i < last; i++) {
        let row = 1u + order[i];
        spans[row].x = slot;
        slot += spans[row].y;
    }
}
