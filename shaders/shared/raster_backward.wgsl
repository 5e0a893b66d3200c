// The backward of blending for one tile, without its reduction: `store_partial`, PARTIALS and the
// number of splats between two reductions, GROUP (at most WIDTH), come from
// shared/partial_subgroup.wgsl or shared/partial_workgroup.wgsl. Replays the forward order, so both
// take the same decisions. The light behind a splat is (final colour - colour so far), so nothing
// is divided by T.
// Reads image, image_gradient [3, height, width]; writes every row of the tile once. With v =
// dL/dsigma: slot_colours (by r g b, sum v), slot_moments (sums of v dx, v dy, v dx^2, v dx dy),
// and the second half of slot_words (bits of the sum of v dy^2), all [slots]. The first half holds
// the Gaussians of the slots.
#import shared/raster_pixels_backward.wgsl
#import shared/tile_range.wgsl

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<storage, read> tile_ranges: array<TileRange>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read_write> slot_words: array<u32>;
@group(0) @binding(4) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> image: array<f32>;
@group(0) @binding(6) var<storage, read> image_gradient: array<f32>;
@group(0) @binding(7) var<storage, read_write> slot_colours: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> slot_moments: array<vec4<f32>>;

const SUMS: u32 = 9;

var<workgroup> partials: array<f32, SUMS * GROUP * PARTIALS>;

fn store_row(slot: u32, row: array<f32, SUMS>) {
    let slots_held = arrayLength(&slot_words) / 2u;
    if (slot >= min(slots_held, min(arrayLength(&slot_colours), arrayLength(&slot_moments)))) {
        return;
    }
    slot_colours[slot] = vec4<f32>(row[0], row[1], row[2], row[3]);
    slot_moments[slot] = vec4<f32>(row[4], row[5], row[6], row[7]);
    slot_words[slots_held + slot] = bitcast<u32>(row[8]);
}

// Adds the invocations' sums for splat `j` of the batch, always in the same order, and writes its
// row.
fn finish_splat(j: u32, slot: u32) {
    var row: array<f32, SUMS>;
    for (var i = 0u; i < SUMS; i++) {
        var sum = 0.0;
        for (var k = 0u; k < PARTIALS; k++) {
            sum += partials[(i * PARTIALS + k) * GROUP + j];
        }
        row[i] = sum;
    }
    store_row(slot, row);
}

fn backward(tile: u32, lane: u32, lane_in_subgroup: u32) {
    let plane = camera.size.x * camera.size.y;
    let tiles = camera.tiles.x * camera.tiles.y;
    // The kernel is unchecked: a camera larger than the buffers gives no gradient.
    let fits = 3u * plane <= min(arrayLength(&image), arrayLength(&image_gradient));
    if (!fits || tile > tiles || tile >= arrayLength(&tile_ranges)) {
        return;
    }
    let pixel = first_pixel(tile, lane, camera.tiles.x);
    let centre = vec2<f32>(pixel) + vec2<f32>(0.5);
    let range = tile_ranges[tile];
    let all = min(range.end, arrayLength(&slots));
    let first = min(range.first, all);
    // The slots past the last tile were never blended: their rows are zero.
    let end = select(min(range.last, all), first, tile == tiles);
    begin_pixels(pixel);
    for (var at = first; at < end; at += GROUP) {
        let slot = slots[min(at + lane, all - 1u)];
        if (lane < GROUP) {
            let gaussian = slot_words[min(slot, arrayLength(&slot_words) - 1u)];
            let place = splat_row(gaussian, arrayLength(&projected));
            batch[lane] = splat_of(projected[place], projected[place + 1u], projected[place + 2u]);
        }
        // The batch is loaded before it is read.
        workgroupBarrier();
        let n = min(end - at, GROUP);
        for (var j = 0u; j < n; j++) {
            let splat = batch[j];
            store_partial(j, lane, lane_in_subgroup,
                blend_backward(splat, centre - splat.place.xy));
        }
        // All partial sums of the batch are stored.
        workgroupBarrier();
        if (lane < n) {
            finish_splat(lane, slot);
        }
        // All reads of the batch are done.
        workgroupBarrier();
    }
    for (var at = max(end, first) + lane; at < all; at += WIDTH) {
        store_row(slots[at], array<f32, SUMS>());
    }
}
