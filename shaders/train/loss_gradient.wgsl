// The gradient of the loss at 4 columns x `run` rows of one channel an invocation: the second half.
// Reads prediction [3, H, W], truth [ceil(3 H W / 2)], derivatives [3, H, W]. Writes gradient [3,
// H, W] and error_sums [invocations] (sums of |p - t| and (p - t)^2). Dispatch: as loss_similarity.
// dL/dp = 0.8 / N sign(p - t) - 0.2 / N (G * dS/dm + 2 p G * dS/dmxx + t G * dS/dmxy), N = 3 H W.
#import shared/grid.wgsl
#import shared/loss.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> size: LossUniform;
@group(0) @binding(1) var<storage, read> prediction: array<f32>;
@group(0) @binding(2) var<storage, read> truth: array<u32>;
@group(0) @binding(3) var<storage, read> derivatives: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> gradient: array<f32>;
@group(0) @binding(5) var<storage, read_write> error_sums: array<vec2<f32>>;

// The three derivatives of a column; zero outside of the row.
fn moments(first: u32, column: u32, block: Block) -> vec3<f32> {
    let at = block.x + column;
    let inside = at >= RADIUS && at < size.width + RADIUS;
    let index = select(block.plane, first + column - RADIUS, inside);
    return select(vec3<f32>(0.0), derivatives[index].xyz, inside);
}

fn blur(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>, d: vec3<f32>, e: vec3<f32>,
    f: vec3<f32>) -> vec3<f32> {
    return G0 * a + G1 * b + G2 * c + G3 * d + G4 * e + G5 * f;
}

// The derivatives of a row's columns x - 5 .. x + 8, blurred horizontally at x .. x + 3, a column
// each.
fn blurred_row(block: Block, y: u32) -> mat4x3<f32> {
    let first = block.plane + y * size.width + block.x;
    let p0 = moments(first, 0u, block);
    let p1 = moments(first, 1u, block);
    let p2 = moments(first, 2u, block);
    let p3 = moments(first, 3u, block);
    let p4 = moments(first, 4u, block);
    let p5 = moments(first, 5u, block);
    let p6 = moments(first, 6u, block);
    let p7 = moments(first, 7u, block);
    let p8 = moments(first, 8u, block);
    let p9 = moments(first, 9u, block);
    let p10 = moments(first, 10u, block);
    let p11 = moments(first, 11u, block);
    let p12 = moments(first, 12u, block);
    let p13 = moments(first, 13u, block);
    return mat4x3<f32>(
        blur(p0 + p10, p1 + p9, p2 + p8, p3 + p7, p4 + p6, p5),
        blur(p1 + p11, p2 + p10, p3 + p9, p4 + p8, p5 + p7, p6),
        blur(p2 + p12, p3 + p11, p4 + p10, p5 + p9, p6 + p8, p7),
        blur(p3 + p13, p4 + p12, p5 + p11, p6 + p10, p7 + p9, p8),
    );
}

// Stores the gradient of one pixel and returns its absolute and squared error.
fn emit(block: Block, column: u32, y: u32, blurred: vec3<f32>) -> vec2<f32> {
    let x = block.x + column;
    if x >= size.width {
        return vec2<f32>(0.0);
    }
    let at = block.plane + y * size.width + x;
    let p = prediction[at];
    let t = unpacked(truth[at / 2u], at);
    let error = p - t;
    let similarity = blurred.x + 2.0 * p * blurred.y + t * blurred.z;
    gradient[at] = size.l1_weight * sign(error) - size.ssim_weight * similarity;
    return vec2<f32>(abs(error), error * error);
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let invocation = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    let block = block_of(invocation, size);
    if !block.valid {
        return;
    }
    var a0 = mat4x3<f32>();
    var a1 = mat4x3<f32>();
    var a2 = mat4x3<f32>();
    var a3 = mat4x3<f32>();
    var a4 = mat4x3<f32>();
    var a5 = mat4x3<f32>();
    var a6 = mat4x3<f32>();
    var a7 = mat4x3<f32>();
    var a8 = mat4x3<f32>();
    var a9 = mat4x3<f32>();
    var sum = vec2<f32>(0.0);
    // Step k blurs the row y - 5 + k and completes the row y - 10 + k.
    for (var k = 0u; k < size.run + 2u * RADIUS; k++) {
        let at = block.y + k;
        var row = mat4x3<f32>();
        if at >= RADIUS && at < size.height + RADIUS {
            row = blurred_row(block, at - RADIUS);
        }
        if k >= 2u * RADIUS && at < size.height + 2u * RADIUS {
            let done = a0 + G0 * row;
            let y = at - 2u * RADIUS;
            sum += emit(block, 0u, y, done[0]) + emit(block, 1u, y, done[1]);
            sum += emit(block, 2u, y, done[2]) + emit(block, 3u, y, done[3]);
        }
        a0 = a1 + G1 * row;
        a1 = a2 + G2 * row;
        a2 = a3 + G3 * row;
        a3 = a4 + G4 * row;
        a4 = a5 + G5 * row;
        a5 = a6 + G4 * row;
        a6 = a7 + G3 * row;
        a7 = a8 + G2 * row;
        a8 = a9 + G1 * row;
        a9 = G0 * row;
    }
    error_sums[invocation] = sum;
}
