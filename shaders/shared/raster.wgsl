// What blending and its backward share, so that both take identical decisions: the pixels of an invocation,
// the splats of a batch in workgroup memory, and alpha.
#import shared/tiles.wgsl

// Consecutive pixels of a row that one invocation owns, and invocations of a tile's workgroup.
const PIXELS: u32 = 16;
const WIDTH: u32 = TILE * TILE / PIXELS;
// Four pixels are one vector: a quarter of the loop and of its bounds checks.
const QUADS: u32 = PIXELS / 4;

const ALPHA_MAX: f32 = 0.99;
const TRANSMITTANCE_STOP: f32 = 1e-4;

const LOG2_E: f32 = 1.4426950408889634;

struct Batch {
    // Mean x y, opacity, its logarithm to base 2.
    place: vec4<f32>,
    // Conic a, b, c, the most that alpha may be.
    conic: vec4<f32>,
    colour: vec4<f32>,
}

var<workgroup> batch: array<Batch, WIDTH>;

// Copies one row of `projected` to the batch.
fn load_splat(lane: u32, first: vec4<f32>, second: vec4<f32>, third: vec4<f32>) {
    let opacity = second.y;
    batch[lane] = Batch(
        vec4<f32>(first.xy, opacity, log2(opacity)),
        // A needle's exponent may round to beyond its peak.
        vec4<f32>(first.zw, second.x, min(ALPHA_MAX, opacity)),
        vec4<f32>(second.zw, third.x, 0.0),
    );
}

// Index of a Gaussian's row among `length` vectors; never past the end, because the kernels are unchecked.
fn splat_row(gaussian: u32, length: u32) -> u32 {
    return min(gaussian, max(length, 3u) / 3u - 1u) * 3u;
}

// First pixel of an invocation, px.
fn first_pixel(tile: u32, lane: u32, tiles_x: u32) -> vec2<u32> {
    let in_tile = lane * PIXELS;
    return vec2<u32>(tile % tiles_x, tile / tiles_x) * TILE + vec2<u32>(in_tile % TILE, in_tile / TILE);
}

// What a row of pixels shares of log2(opacity exp(-sigma)), a polynomial in dx: the factors of dx^2, dx and 1.
// sigma = 0.5 a dx^2 + b dx dy + 0.5 c dy^2.
fn row_exponent(splat: Batch, dy: f32) -> vec3<f32> {
    return vec3<f32>(
        -0.5 * LOG2_E * splat.conic.x,
        -LOG2_E * splat.conic.y * dy,
        splat.place.w - 0.5 * LOG2_E * splat.conic.z * dy * dy,
    );
}

// Opacity before the clamp, at four pixels; 0 where the splat does not count. `dx`: pixel centres minus mean.
fn raw_alpha(dx: vec4<f32>, row: vec3<f32>) -> vec4<f32> {
    let raw = exp2(dx * (row.x * dx + row.y) + row.z);
    return select(vec4<f32>(0.0), raw, raw >= vec4<f32>(ALPHA_CUT));
}

// Which of four pixels lie inside the image.
fn inside_image(pixel: vec2<u32>, size: vec2<u32>) -> vec4<bool> {
    let x = vec4<u32>(pixel.x) + vec4<u32>(0u, 1u, 2u, 3u);
    return (x < vec4<u32>(size.x)) & vec4<bool>(pixel.y < size.y);
}
