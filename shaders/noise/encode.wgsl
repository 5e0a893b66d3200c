// Encodes position and viewing direction of one pixel of the chunk an invocation.
// Reads nothing but the camera. Writes encoded [count, 64] and the last 28 columns of features
// [count, 156]. Dispatch: count.
// x = (2 u / W - 1, 2 v / H - 1, 2 * 16 / 63 - 1), d = R^T K^-1 (u, v, 1) normalised; gamma(x) =
// (x, sin 2^k x, cos 2^k x).
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

// Floats a row of the encoded positions.
const ENCODED_STRIDE: u32 = 64u;
// Floats a row of the features, the first of the direction's encoding, and its octaves.
const FEATURE_STRIDE: u32 = 156u;
const DIRECTION: u32 = 128u;
const DIRECTION_OCTAVES: u32 = 4u;

@group(0) @binding(0) var<uniform> field: NoiseUniform;
@group(0) @binding(1) var<uniform> chunk: ChunkUniform;
@group(0) @binding(2) var<storage, read_write> encoded: array<f32>;
@group(0) @binding(3) var<storage, read_write> features: array<f32>;

fn store_encoded(at: u32, v: vec3<f32>) {
    encoded[at] = v.x;
    encoded[at + 1u] = v.y;
    encoded[at + 2u] = v.z;
}

fn store_feature(at: u32, v: vec3<f32>) {
    features[at] = v.x;
    features[at + 1u] = v.y;
    features[at + 2u] = v.z;
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    if index >= chunk.count {
        return;
    }
    let at_pixel = chunk.first + index;
    let pixel = vec2<f32>(f32(at_pixel % field.width), f32(at_pixel / field.width)) + 0.5;
    let size = vec2<f32>(f32(field.width), f32(field.height));
    let position = vec3<f32>(2.0 * pixel / size - 1.0, 32.0 / 63.0 - 1.0);
    let camera = vec3<f32>((pixel - field.centre) / field.focal, 1.0);
    let world = field.row_x.xyz * camera.x + field.row_y.xyz * camera.y
        + field.row_z.xyz * camera.z;
    let direction = normalize(world);

    var at = index * ENCODED_STRIDE;
    store_encoded(at, position);
    var frequency = 1.0;
    for (var k = 0u; k < field.octaves; k++) {
        store_encoded(at + 3u, sin(frequency * position));
        store_encoded(at + 6u, cos(frequency * position));
        frequency *= 2.0;
        at += 6u;
    }
    // The row is filled up to a multiple of 4 with one zero.
    encoded[at + 3u] = 0.0;

    at = index * FEATURE_STRIDE + DIRECTION;
    store_feature(at, direction);
    frequency = 1.0;
    for (var k = 0u; k < DIRECTION_OCTAVES; k++) {
        store_feature(at + 3u, sin(frequency * direction));
        store_feature(at + 6u, cos(frequency * direction));
        frequency *= 2.0;
        at += 6u;
    }
    features[at + 3u] = 0.0;
}
