// The gradients by the splats of a tile, one half after the other, by one subgroup;
// see shared/raster_walk.wgsl. Replays the forward order, so both take the same decisions: behind a
// splat lies (final colour - colour so far), T is never divided by.
// Reads image, image_gradient [3, height, width], last [tiles, 2]; writes every row of the tile.
// With v = dL/dsigma: slot_colours (by r g b, sum v), slot_moments (sums of v dx, v dy, v dx^2, v
// dx dy), slot_tails (v dy^2), all [slots].
// Dispatch: a workgroup a tile, and one for the slots that belong to none.
#import shared/grid.wgsl
#import shared/raster_pixels_backward.wgsl
#import shared/raster_walk.wgsl
#import shared/reduce_sums.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<storage, read> tile_ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> slot_gaussian: array<u32>;
@group(0) @binding(4) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> image: array<f32>;
@group(0) @binding(6) var<storage, read> image_gradient: array<f32>;
@group(0) @binding(7) var<storage, read> last: array<u32>;
@group(0) @binding(8) var<storage, read_write> slot_colours: array<f32>;
@group(0) @binding(9) var<storage, read_write> slot_moments: array<f32>;
@group(0) @binding(10) var<storage, read_write> slot_tails: array<f32>;

// Whether a slot is one of the buffers'; the kernel is unchecked.
fn is_slot(slot: u32) -> bool {
    let vectors = min(arrayLength(&slot_colours), arrayLength(&slot_moments)) / 4u;
    return slot < min(vectors, arrayLength(&slot_tails));
}

// Lane i below 8 keeps sum i of a splat, the first also the ninth. What it kept of the other half
// is added.
fn keep(slot: u32, lane: u32, reduced: vec2<f32>, add: bool) {
    let at = 4u * slot + lane % 4u;
    if (lane < 4u) {
        slot_colours[at] = reduced.x + select(0.0, slot_colours[at], add);
    } else if (lane < 8u) {
        slot_moments[at] = reduced.x + select(0.0, slot_moments[at], add);
    }
    if (lane == 0u) {
        slot_tails[slot] = reduced.y + select(0.0, slot_tails[slot], add);
    }
}

fn keep_nothing(slot: u32) {
    for (var i = 0u; i < 4u; i++) {
        slot_colours[4u * slot + i] = 0.0;
        slot_moments[4u * slot + i] = 0.0;
    }
    slot_tails[slot] = 0.0;
}

fn backward(tile: u32, half: u32, range: vec2<u32>, ends: array<u32, HALVES>, lane: u32) {
    let pixel = first_pixel(tile, half * SUBGROUP + lane, camera.tiles.x);
    let centre = vec2<f32>(pixel) + vec2<f32>(0.5);
    begin_pixels(pixel);
    // The upper half goes on to the end of the list: it writes the rows of splats that neither half
    // counts.
    let end = select(ends[1], range.y, half == 0u);
    for (var at = range.x; at < end; at += SUBGROUP) {
        let mine = at + lane;
        let slot = slots[min(mine, range.y - 1u)];
        let own = own_splat(slot, tile);
        let valid = mine < range.y && is_slot(slot);
        let upper = valid && mine < ends[0] && own.touches[0];
        let lower = valid && mine < ends[1] && own.touches[1];
        if (half == 0u && valid && !(upper || lower)) {
            keep_nothing(slot);
        }
        let above = subgroupBallot(upper).x;
        let below = subgroupBallot(lower).x;
        var bits = select(below, above, half == 0u);
        while (bits != 0u) {
            let j = countTrailingZeros(bits);
            bits &= bits - 1u;
            let splat = handed(own.splat, j);
            let reduced = reduce_sums(lane, blend_backward(splat, centre - splat.place.xy));
            keep(subgroupShuffle(slot, j), lane, reduced, half == 1u && (above >> j & 1u) != 0u);
        }
    }
}

@compute @workgroup_size(SUBGROUP)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let tile = flat_workgroup(workgroup, workgroups);
    let plane = camera.size.x * camera.size.y;
    let tiles = camera.tiles.x * camera.tiles.y;
    // The kernel is unchecked: a camera larger than the buffers gives no gradient.
    let fits = 3u * plane <= min(arrayLength(&image), arrayLength(&image_gradient));
    if (!fits || tile > tiles
        || tile >= min(arrayLength(&last) / HALVES, arrayLength(&tile_ranges))) {
        return;
    }
    let range = min(tile_ranges[tile], vec2<u32>(arrayLength(&slots)));
    // The slots past the last tile were never blended: their rows are zero.
    let blended = tile < tiles;
    let ends = array<u32, HALVES>(
        select(range.x, min(last[HALVES * tile], range.y), blended),
        select(range.x, min(last[HALVES * tile + 1u], range.y), blended),
    );
    for (var half = 0u; half < HALVES; half++) {
        backward(tile, half, range, ends, lane);
    }
}
