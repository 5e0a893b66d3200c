// What blending and its backward share, so that both take identical decisions: the pixels of an invocation,
// the splats of a batch in workgroup memory, and alpha.
#import shared/tiles.wgsl

// Consecutive pixels of a row that one invocation owns, and invocations of a tile's workgroup.
const PIXELS: u32 = 16;
const WIDTH: u32 = TILE * TILE / PIXELS;

const ALPHA_MAX: f32 = 0.99;
const TRANSMITTANCE_STOP: f32 = 1e-4;

struct Batch {
    // Mean x y, opacity, unused.
    place: vec4<f32>,
    // Conic a, b, c, unused.
    conic: vec4<f32>,
    colour: vec4<f32>,
}

var<workgroup> batch: array<Batch, WIDTH>;

// Copies one row of `projected` to the batch.
fn load_splat(lane: u32, first: vec4<f32>, second: vec4<f32>, third: vec4<f32>) {
    batch[lane] = Batch(
        vec4<f32>(first.xy, second.y, 0.0),
        vec4<f32>(first.zw, second.x, 0.0),
        vec4<f32>(second.zw, third.x, 0.0),
    );
}

// First pixel of an invocation, px.
fn first_pixel(tile: u32, lane: u32, tiles_x: u32) -> vec2<u32> {
    let in_tile = lane * PIXELS;
    return vec2<u32>(tile % tiles_x, tile / tiles_x) * TILE + vec2<u32>(in_tile % TILE, in_tile / TILE);
}

// Opacity before the clamp, exp(-sigma) * opacity; 0 where the splat does not count at this pixel.
// `offset`: pixel centre minus mean; `slope` and `base` are the parts of sigma that a row shares:
// sigma = offset * (0.5 a * offset + slope) + base, slope = b dy, base = 0.5 c dy^2.
fn raw_alpha(offset: f32, half_a: f32, slope: f32, base: f32, opacity: f32) -> f32 {
    let sigma = offset * (half_a * offset + slope) + base;
    let raw = opacity * exp(-sigma);
    return select(0.0, raw, sigma >= 0.0 && raw >= ALPHA_CUT);
}
