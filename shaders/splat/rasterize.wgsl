// Blends the splats of a tile front to back. A workgroup a tile, PIXELS consecutive pixels of a row an invocation.
// Reads camera, tile_ranges [tiles], slots [n] sorted, slot_gaussian [n], projected [count, 3]. Writes image
// [3, height, width], transmittance [height, width], last [tiles]: one past the last intersection that counted.
// Dispatch: a workgroup a tile. C = sum c alpha T, T <- T (1 - alpha), stop before T would pass below 1e-4.
#import shared/grid.wgsl
#import shared/raster.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<storage, read> tile_ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> slot_gaussian: array<u32>;
@group(0) @binding(4) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> image: array<f32>;
@group(0) @binding(6) var<storage, read_write> transmittance: array<f32>;
@group(0) @binding(7) var<storage, read_write> last: array<u32>;

var<workgroup> live: atomic<u32>;
var<workgroup> go_on: u32;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let tile = flat_workgroup(workgroup, workgroups);
    if (tile >= camera.tiles.x * camera.tiles.y) {
        return;
    }
    let pixel = first_pixel(tile, lane, camera.tiles.x);
    let centre = vec2<f32>(pixel) + vec2<f32>(0.5);
    let range = tile_ranges[tile];
    // A negative T marks a pixel that has stopped, or lies outside the image; its magnitude stays.
    var t: array<f32, PIXELS>;
    var colour: array<vec3<f32>, PIXELS>;
    for (var k = 0u; k < PIXELS; k++) {
        t[k] = select(-1.0, 1.0, pixel.x + k < camera.size.x && pixel.y < camera.size.y);
        colour[k] = vec3<f32>(0.0);
    }
    var at = range.x;
    loop {
        if (at >= range.y) {
            break;
        }
        let slot = slots[min(at + lane, range.y - 1u)];
        let row = 3u * slot_gaussian[slot];
        load_splat(lane, projected[row], projected[row + 1u], projected[row + 2u]);
        if (lane == 0u) {
            atomicStore(&live, 0u);
        }
        // The batch is loaded before it is read.
        workgroupBarrier();
        let n = min(range.y - at, WIDTH);
        for (var j = 0u; j < n; j++) {
            let splat = batch[j];
            let offset = centre - splat.place.xy;
            let half_a = 0.5 * splat.conic.x;
            let slope = splat.conic.y * offset.y;
            let base = 0.5 * splat.conic.z * offset.y * offset.y;
            for (var k = 0u; k < PIXELS; k++) {
                let raw = raw_alpha(offset.x + f32(k), half_a, slope, base, splat.place.z);
                let alpha = min(raw, ALPHA_MAX);
                let before = t[k];
                let after = before * (1.0 - alpha);
                let stop = after < TRANSMITTANCE_STOP;
                colour[k] += select(alpha * before, 0.0, stop) * splat.colour.xyz;
                t[k] = select(after, -abs(before), stop);
            }
        }
        at += n;
        var most = t[0];
        for (var k = 1u; k < PIXELS; k++) {
            most = max(most, t[k]);
        }
        if (most > 0.0) {
            atomicStore(&live, 1u);
        }
        // All have said whether they live, and nobody still reads the batch.
        workgroupBarrier();
        if (lane == 0u) {
            go_on = atomicLoad(&live);
        }
        if (workgroupUniformLoad(&go_on) == 0u) {
            break;
        }
    }
    if (lane == 0u) {
        last[tile] = at;
    }
    let plane = camera.size.x * camera.size.y;
    for (var k = 0u; k < PIXELS; k++) {
        if (pixel.x + k < camera.size.x && pixel.y < camera.size.y) {
            let i = pixel.y * camera.size.x + pixel.x + k;
            image[i] = colour[k].x;
            image[plane + i] = colour[k].y;
            image[2u * plane + i] = colour[k].z;
            transmittance[i] = abs(t[k]);
        }
    }
}
