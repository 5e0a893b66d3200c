// Counts the visible Gaussians of a block, those that touch a tile.
// Reads camera, spans [1 + count]. Writes block_sums [blocks]. Dispatch: a workgroup a block.
#import shared/grid.wgsl
#import shared/camera.wgsl
#import shared/workgroup_scan.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> block_sums: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_workgroup(workgroup, workgroups);
    let first = min(block * BLOCK + lane * ITEMS, camera.count);
    let last = min(first + ITEMS, camera.count);
    var sum = 0u;
    for (var i = first; i < last; i++) {
        sum += u32(spans[1u + i].y != 0u);
    }
    let scanned = workgroup_scan(sum, lane);
    // Blocks past the count have the sum 0: the scan reads every block there is room for.
    if (lane == 0u && block < arrayLength(&block_sums)) {
        block_sums[block] = scanned.total;
    }
}
