// Gathers the visible Gaussians in their order: by prefix sum, so that ties in depth stay stable.
// Reads camera, spans [1 + count], depth_keys [count], block_sums [blocks] scanned. Writes keys
// [visible], payloads [visible]: depth and index of the Gaussian. Dispatch: a workgroup a block.
#import shared/grid.wgsl
#import shared/camera.wgsl
#import shared/workgroup_scan.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> depth_keys: array<u32>;
@group(0) @binding(3) var<storage, read> block_sums: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> payloads: array<u32>;

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
    if (first >= last) {
        return;
    }
    var place = block_sums[block] + scanned.before;
    for (var i = first; i < last; i++) {
        if (spans[1u + i].y != 0u) {
            keys[place] = depth_keys[i];
            payloads[place] = i;
            place += 1u;
        }
    }
}
