// Writes an intersection for every tile a visible Gaussian touches: its slots are contiguous and in
// order of depth. Never more than were counted, and never past the capacity (the exact number stays
// in the counter).
// Reads camera, parameters, counters, order [visible], projected [count, 3], spans [1 + count].
// Writes keys [slots] (tile), payloads [slots] (slot), and the Gaussians in slot_words.
// Dispatch: visible.
#import shared/grid.wgsl
#import shared/sort.wgsl
#import shared/tiles.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<uniform> parameters: SortParameters;
@group(0) @binding(2) var<storage, read> counters: array<u32>;
@group(0) @binding(3) var<storage, read> order: array<u32>;
@group(0) @binding(4) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> keys: array<u32>;
@group(0) @binding(7) var<storage, read_write> payloads: array<u32>;
@group(0) @binding(8) var<storage, read_write> slot_words: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    if (i >= min(counters[parameters.source], parameters.capacity)) {
        return;
    }
    let gaussian = order[i];
    let first = projected[3u * gaussian];
    let second = projected[3u * gaussian + 1u];
    let conic = vec3<f32>(first.zw, second.x);
    let limit = exponent_limit(second.y);
    let box = tile_box(first.xy, projected[3u * gaussian + 2u].zw, camera.tiles);
    let span = spans[1u + gaussian];
    var slot = span.x;
    let end = min(slot + span.y, parameters.result_capacity);
    for (var y = box.y; y < box.w; y++) {
        for (var x = box.x; x < box.z; x++) {
            if (slot < end && tile_touched(first.xy, conic, limit, vec2<u32>(x, y))) {
                keys[slot] = y * camera.tiles.x + x;
                payloads[slot] = slot;
                slot_words[slot] = gaussian;
                slot += 1u;
            }
        }
    }
    // Two kernels may round differently: a tile that was counted and is not touched goes past the
    // last tile.
    for (; slot < end; slot++) {
        keys[slot] = camera.tiles.x * camera.tiles.y;
        payloads[slot] = slot;
        slot_words[slot] = gaussian;
    }
}
