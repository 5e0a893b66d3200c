// First and one past the last intersection of a tile, by binary search in the sorted tile ids.
// Reads camera, parameters, counters, keys [slots] sorted. Writes tile_ranges [tiles + 1]; the last
// is for the slots of no tile. Copies the number of intersections into the first row of spans.
// Dispatch: tiles + 1.
#import shared/grid.wgsl
#import shared/sort.wgsl
#import shared/camera.wgsl
#import shared/tile_range.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<uniform> parameters: SortParameters;
@group(0) @binding(2) var<storage, read> counters: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<u32>;
@group(0) @binding(4) var<storage, read_write> tile_ranges: array<TileRange>;
@group(0) @binding(5) var<storage, read_write> spans: array<vec2<u32>>;

// The first of the `n` keys that is not below `tile`.
fn lower_bound(tile: u32, n: u32) -> u32 {
    var low = 0u;
    var high = n;
    for (var step = 0u; step < 32u && low < high; step++) {
        let middle = (low + high) / 2u;
        if (keys[middle] < tile) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let tile = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    if (tile > camera.tiles.x * camera.tiles.y) {
        return;
    }
    let n = min(counters[parameters.source], parameters.capacity);
    tile_ranges[tile] = TileRange(lower_bound(tile, n), lower_bound(tile + 1u, n), 0u);
    if (tile == 0u) {
        spans[0].x = counters[parameters.source];
    }
}
