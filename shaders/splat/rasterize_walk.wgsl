// Blends the splats of a tile front to back, each half of it by a subgroup of its own;
// see shared/raster_walk.wgsl.
// Reads camera, tile_ranges [tiles], slots [n] sorted, slot_gaussian [n], projected [count, 3].
// Writes image [3, height, width], transmittance [height, width], last [tiles, 2]: one past the
// last intersection that counted.
// Dispatch: a workgroup a tile. C = sum c alpha T, T <- T (1 - alpha), stop before T would pass
// below 1e-4; T background is added.
#import shared/grid.wgsl
#import shared/raster_pixels.wgsl
#import shared/raster_walk.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<storage, read> tile_ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> slot_gaussian: array<u32>;
@group(0) @binding(4) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> image: array<f32>;
@group(0) @binding(6) var<storage, read_write> transmittance: array<f32>;
@group(0) @binding(7) var<storage, read_write> last: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(subgroup_invocation_id) lane_in_subgroup: u32,
) {
    let tile = flat_workgroup(workgroup, workgroups);
    let plane = camera.size.x * camera.size.y;
    // The kernel is unchecked: a camera larger than the buffers draws nothing.
    let fits = 3u * plane <= arrayLength(&image) && plane <= arrayLength(&transmittance);
    let tiles = min(arrayLength(&last) / HALVES, arrayLength(&tile_ranges));
    if (!fits || tile >= min(camera.tiles.x * camera.tiles.y, tiles)) {
        return;
    }
    let half = lane / SUBGROUP;
    let pixel = first_pixel(tile, lane, camera.tiles.x);
    let centre = vec2<f32>(pixel) + vec2<f32>(0.5);
    let range = min(tile_ranges[tile], vec2<u32>(arrayLength(&slots)));
    begin_pixels(pixel);
    var at = range.x;
    while (at < range.y) {
        let mine = at + lane_in_subgroup;
        let own = own_splat(slots[min(mine, range.y - 1u)], tile);
        let touches = select(own.touches[1], own.touches[0], half == 0u);
        var bits = subgroupBallot(touches && mine < range.y).x;
        while (bits != 0u) {
            let splat = handed(own.splat, countTrailingZeros(bits));
            bits &= bits - 1u;
            blend(splat, centre - splat.place.xy);
        }
        at = min(at + SUBGROUP, range.y);
        if (subgroupAll(all_stopped())) {
            break;
        }
    }
    if (lane_in_subgroup == 0u) {
        last[HALVES * tile + half] = at;
    }
    write_pixels(pixel);
}
