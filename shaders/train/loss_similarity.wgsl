// SSIM of 4 columns x `run` rows of one channel an invocation, and its derivatives by the window's
// moments: the first half of the loss.
// Reads prediction [3, H, W], truth [ceil(3 H W / 2)] (two 16-bit values a word) and its noise.
// Writes derivatives [3, H, W] (by three moments, one unused) and similarity_sums [invocations].
// Dispatch: 3 blocks_x blocks_y invocations.
// S = (2 mx my + C1)(2 sxy + c2) / ((mx^2 + my^2 + C1)(sxx + syy + c2)), moments zero-padded, c2 =
// C2 + 2 s^2 with s the standard deviation of the target's noise at the brightness my.
#import shared/grid.wgsl
#import shared/loss.wgsl

const WIDTH: u32 = 32;

// Levels of brightness at which the noise is known: the middles of equal parts of 0..=1.
const LEVELS: u32 = 16u;

struct NoiseUniform {
    // Changes of the slope of its standard deviation at the levels.
    bends: array<vec4<f32>, 4>,
    // The deviation at the first level.
    first: f32,
}

@group(0) @binding(0) var<uniform> size: LossUniform;
@group(0) @binding(1) var<uniform> noise: NoiseUniform;
@group(0) @binding(2) var<storage, read> prediction: array<f32>;
@group(0) @binding(3) var<storage, read> truth: array<u32>;
@group(0) @binding(4) var<storage, read_write> derivatives: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> similarity_sums: array<f32>;

// x, y, x^2 + y^2 and x y of a column; zero outside of the row.
fn products(first: u32, column: u32, y: f32, block: Block) -> vec4<f32> {
    let at = block.x + column;
    let inside = at >= RADIUS && at < size.width + RADIUS;
    let x = prediction[select(block.plane, first + column - RADIUS, inside)];
    return select(vec4<f32>(0.0), vec4<f32>(x, y, x * x + y * y, x * y), inside);
}

// A word of the packed target. Words before the first and behind the last hold no column of the
// row.
fn word(index: i32) -> u32 {
    return truth[clamp(index, 0, i32(size.values + 1u) / 2 - 1)];
}

fn blur(a: vec4<f32>, b: vec4<f32>, c: vec4<f32>, d: vec4<f32>, e: vec4<f32>,
    f: vec4<f32>) -> vec4<f32> {
    return G0 * a + G1 * b + G2 * c + G3 * d + G4 * e + G5 * f;
}

// The products of a row's columns x - 5 .. x + 8, blurred horizontally at x .. x + 3, a column
// each.
fn blurred_row(block: Block, y: u32) -> mat4x4<f32> {
    let first = block.plane + y * size.width + block.x;
    // The 14 values from first - 5 on lie in 8 words; an odd start leaves out the first half-word.
    let begin = i32((first + 1u) >> 1u) - 3;
    let odd = ((first + 1u) & 1u) == 1u;
    let a = unpack2x16unorm(word(begin + 0));
    let b = unpack2x16unorm(word(begin + 1));
    let c = unpack2x16unorm(word(begin + 2));
    let d = unpack2x16unorm(word(begin + 3));
    let e = unpack2x16unorm(word(begin + 4));
    let f = unpack2x16unorm(word(begin + 5));
    let g = unpack2x16unorm(word(begin + 6));
    let h = unpack2x16unorm(word(begin + 7));
    let p0 = products(first, 0u, select(a.x, a.y, odd), block);
    let p1 = products(first, 1u, select(a.y, b.x, odd), block);
    let p2 = products(first, 2u, select(b.x, b.y, odd), block);
    let p3 = products(first, 3u, select(b.y, c.x, odd), block);
    let p4 = products(first, 4u, select(c.x, c.y, odd), block);
    let p5 = products(first, 5u, select(c.y, d.x, odd), block);
    let p6 = products(first, 6u, select(d.x, d.y, odd), block);
    let p7 = products(first, 7u, select(d.y, e.x, odd), block);
    let p8 = products(first, 8u, select(e.x, e.y, odd), block);
    let p9 = products(first, 9u, select(e.y, f.x, odd), block);
    let p10 = products(first, 10u, select(f.x, f.y, odd), block);
    let p11 = products(first, 11u, select(f.y, g.x, odd), block);
    let p12 = products(first, 12u, select(g.x, g.y, odd), block);
    let p13 = products(first, 13u, select(g.y, h.x, odd), block);
    return mat4x4<f32>(
        blur(p0 + p10, p1 + p9, p2 + p8, p3 + p7, p4 + p6, p5),
        blur(p1 + p11, p2 + p10, p3 + p9, p4 + p8, p5 + p7, p6),
        blur(p2 + p12, p3 + p11, p4 + p10, p5 + p9, p6 + p8, p7),
        blur(p3 + p13, p4 + p12, p5 + p11, p6 + p10, p7 + p9, p8),
    );
}

// Standard deviation of the noise where the target has this mean.
fn deviation_at(mean: f32) -> f32 {
    var deviation = noise.first;
    for (var n = 0u; n < LEVELS; n++) {
        let level = (f32(n) + 0.5) / f32(LEVELS);
        deviation += noise.bends[n / 4u][n % 4u] * max(mean - level, 0.0);
    }
    return max(deviation, 0.0);
}

// Similarity, and its derivatives by mx, by the mean of x^2, and by the mean of x y.
fn similarity(m: vec4<f32>) -> vec4<f32> {
    let deviation = deviation_at(m.y);
    let c2 = C2 + 2.0 * deviation * deviation;
    let a1 = 2.0 * m.x * m.y + C1;
    let a2 = 2.0 * (m.w - m.x * m.y) + c2;
    let square = m.x * m.x + m.y * m.y;
    let b1 = square + C1;
    let b2 = m.z - square + c2;
    let inverse = 1.0 / (b1 * b2);
    let s = a1 * a2 * inverse;
    let by_mean = 2.0 * m.y * (a2 - a1) * inverse + 2.0 * m.x * s * (b1 - b2) * inverse;
    return vec4<f32>(s, by_mean, -s / b2, 2.0 * a1 * inverse);
}

// Stores the derivatives of one pixel and returns its similarity; nothing right of the image.
fn emit(block: Block, column: u32, y: u32, moments: vec4<f32>) -> f32 {
    let x = block.x + column;
    if x >= size.width {
        return 0.0;
    }
    let result = similarity(moments);
    derivatives[block.plane + y * size.width + x] = vec4<f32>(result.yzw, 0.0);
    return result.x;
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
    var a0 = mat4x4<f32>();
    var a1 = mat4x4<f32>();
    var a2 = mat4x4<f32>();
    var a3 = mat4x4<f32>();
    var a4 = mat4x4<f32>();
    var a5 = mat4x4<f32>();
    var a6 = mat4x4<f32>();
    var a7 = mat4x4<f32>();
    var a8 = mat4x4<f32>();
    var a9 = mat4x4<f32>();
    var sum = 0.0;
    // Step k blurs the row y - 5 + k and completes the row y - 10 + k.
    for (var k = 0u; k < size.run + 2u * RADIUS; k++) {
        let at = block.y + k;
        var row = mat4x4<f32>();
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
    similarity_sums[invocation] = sum;
}
