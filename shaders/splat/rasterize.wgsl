// Blends the splats of a tile front to back. A workgroup a tile, PIXELS consecutive pixels of a row
// an invocation.
// Reads camera, slots [n] sorted, the Gaussians in slot_words, projected [count, 3]. Reads
// tile_ranges [tiles] and sets `last` there. Writes image [3, height, width], transmittance
// [height, width].
// Dispatch: a workgroup a tile. C = sum c alpha T, T <- T (1 - alpha), stop before T would pass
// below 1e-4; T background is added.
#import shared/grid.wgsl
#import shared/raster_pixels.wgsl
#import shared/tile_range.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<storage, read_write> tile_ranges: array<TileRange>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> slot_words: array<u32>;
@group(0) @binding(4) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> image: array<f32>;
@group(0) @binding(6) var<storage, read_write> transmittance: array<f32>;

var<workgroup> ends: vec2<u32>;
var<workgroup> live: atomic<u32>;
var<workgroup> go_on: u32;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let tile = flat_workgroup(workgroup, workgroups);
    let plane = camera.size.x * camera.size.y;
    // The kernel is unchecked: a camera larger than the buffers draws nothing.
    let fits = 3u * plane <= arrayLength(&image) && plane <= arrayLength(&transmittance);
    if (!fits || tile >= min(camera.tiles.x * camera.tiles.y, arrayLength(&tile_ranges))) {
        return;
    }
    let pixel = first_pixel(tile, lane, camera.tiles.x);
    let centre = vec2<f32>(pixel) + vec2<f32>(0.5);
    if (lane == 0u) {
        let last = min(tile_ranges[tile].end, arrayLength(&slots));
        ends = vec2<u32>(min(tile_ranges[tile].first, last), last);
    }
    // The buffer is written, too, so only this makes the loop uniform by WGSL's rules.
    let range = workgroupUniformLoad(&ends);
    begin_pixels(pixel);
    var at = range.x;
    loop {
        if (at >= range.y) {
            break;
        }
        let slot = slots[min(at + lane, range.y - 1u)];
        let gaussian = slot_words[min(slot, arrayLength(&slot_words) - 1u)];
        let place = splat_row(gaussian, arrayLength(&projected));
        batch[lane] = splat_of(projected[place], projected[place + 1u], projected[place + 2u]);
        if (lane == 0u) {
            atomicStore(&live, 0u);
        }
        // The batch is loaded before it is read.
        workgroupBarrier();
        let n = min(range.y - at, WIDTH);
        for (var j = 0u; j < n; j++) {
            blend(batch[j], centre - batch[j].place.xy);
        }
        at += n;
        if (!all_stopped()) {
            atomicStore(&live, 1u);
        }
        // All invocations have set `live`, and all reads of the batch are done.
        workgroupBarrier();
        if (lane == 0u) {
            go_on = atomicLoad(&live);
        }
        if (workgroupUniformLoad(&go_on) == 0u) {
            break;
        }
    }
    if (lane == 0u) {
        tile_ranges[tile].last = at;
    }
    write_pixels(pixel);
}
