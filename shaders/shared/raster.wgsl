// Shared by blending and its backward, so that both take identical decisions: the pixels of an
// invocation, the data of a splat, and alpha.
#import shared/tiles.wgsl

// Consecutive pixels of a row that one invocation owns as one vector, and invocations of a tile's
// workgroup.
const PIXELS: u32 = 4;
const WIDTH: u32 = TILE * TILE / PIXELS;

const ALPHA_MAX: f32 = 0.99;
const TRANSMITTANCE_STOP: f32 = 1e-4;

const LOG2_E: f32 = 1.4426950408889634;

// The data of a splat for blending.
struct Splat {
    // Mean x y, logarithm of the opacity to base 2, the most that alpha may be.
    place: vec4<f32>,
    // Factors of dx^2, dx dy and dy^2 in the logarithm of alpha to base 2.
    curve: vec3<f32>,
    colour: vec3<f32>,
}

// The splats that the workgroup blends next.
var<workgroup> batch: array<Splat, WIDTH>;

// One row of `projected`.
fn splat_of(first: vec4<f32>, second: vec4<f32>, third: vec4<f32>) -> Splat {
    let opacity = second.y;
    // A needle's exponent may round to beyond its peak.
    let most = min(ALPHA_MAX, opacity);
    // sigma = 0.5 a dx^2 + b dx dy + 0.5 c dy^2.
    let curve = -LOG2_E * vec3<f32>(0.5 * first.z, first.w, 0.5 * second.x);
    return Splat(vec4<f32>(first.xy, log2(opacity), most), curve, vec3<f32>(second.zw, third.x));
}

// Index of a Gaussian's row among `length` vectors; never past the end, because the kernels are
// unchecked.
fn splat_row(gaussian: u32, length: u32) -> u32 {
    return min(gaussian, max(length, 3u) / 3u - 1u) * 3u;
}

// First pixel of an invocation, px.
fn first_pixel(tile: u32, lane: u32, tiles_x: u32) -> vec2<u32> {
    let in_tile = lane * PIXELS;
    return vec2<u32>(tile % tiles_x, tile / tiles_x) * TILE
        + vec2<u32>(in_tile % TILE, in_tile / TILE);
}

// Horizontal offsets of the pixels' centres from the mean; `offset`: that of the first.
fn offset_of_pixels(offset: vec2<f32>) -> vec4<f32> {
    return offset.x + vec4<f32>(0.0, 1.0, 2.0, 3.0);
}

// Opacity before the clamp, opacity exp(-sigma), at the pixels; 0 where the splat has no effect.
fn raw_alpha(offset: vec2<f32>, splat: Splat) -> vec4<f32> {
    let dx = offset_of_pixels(offset);
    let dy = offset.y;
    let rest = splat.place.z + splat.curve.z * dy * dy;
    let raw = exp2(dx * (splat.curve.x * dx + splat.curve.y * dy) + rest);
    return select(vec4<f32>(0.0), raw, raw >= vec4<f32>(ALPHA_CUT));
}

// Which of the pixels lie inside the image; `pixel`: the first.
fn inside_image(pixel: vec2<u32>, size: vec2<u32>) -> vec4<bool> {
    let x = vec4<u32>(pixel.x) + vec4<u32>(0u, 1u, 2u, 3u);
    return (x < vec4<u32>(size.x)) & vec4<bool>(pixel.y < size.y);
}
