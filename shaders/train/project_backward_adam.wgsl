// The gradient of one Gaussian an invocation, from its slots to its parameters, and its Adam update
// in place. Sums the Gaussian's contiguous slots, goes back through conic, covariance, projection,
// harmonics and activations, adds the MCMC regularisers, limits the depth, updates, and adds
// exploration noise.
// Reads slot_colours, slot_moments and the second half of slot_words [slots] (see
// shared/raster_backward.wgsl), and spans [1 + count] (first slot, number of slots); the first row
// has the exact number of intersections and, counted here, that of non-finite gradients dropped.
// Reads and writes geometry [part, 12], geometry_moments [part, 2, 12], sh [part, sh_row],
// sh_moments [part, 2, sh_row].
// Dispatch: the part's rows. Void when the slots overflowed.
// WRITE_GRADIENTS = 1 leaves the parameters and writes the gradient in place of the first moments.
// ACCUMULATE_POSITION = 1 adds the length of the gradient by the position, in normalised device
// coordinates, and a view to the moments' free floats.
#import shared/gaussian_rows.wgsl
#import shared/grid.wgsl
#import shared/part.wgsl
#import shared/projection_backward.wgsl
#import shared/random.wgsl
#import shared/train.wgsl

const WIDTH: u32 = 64;
const WRITE_GRADIENTS: u32 = 0;
const ACCUMULATE_POSITION: u32 = 0;
const BETA_M: f32 = 0.9;
const BETA_V: f32 = 0.999;
const EPSILON: f32 = 1e-15;
// Largest standard deviation along the line of sight, as a share of the depth. EWA is linear about
// the centre: a sheet that recedes farther, like those of a sky, covers the view like fog.
const DEEPEST: f32 = 0.25;

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<uniform> train: StepUniform;
@group(0) @binding(2) var<uniform> part: PartUniform;
@group(0) @binding(3) var<storage, read_write> spans: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read> slot_colours: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> slot_moments: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> slot_words: array<f32>;
@group(0) @binding(7) var<storage, read_write> geometry: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> geometry_moments: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> sh: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> sh_moments: array<vec4<f32>>;

// Finite, and so small that its square is finite too: by bits, for NaN has no order in WGSL.
fn fits3(v: vec3<f32>) -> bool {
    let bits = bitcast<vec3<u32>>(v) & vec3<u32>(0x7fffffffu);
    // 0x5d5e0b6b is 1e18.
    return all(bits < vec3<u32>(0x5d5e0b6bu));
}

// Gradients by the projected quantities.
struct SlotSum {
    mean: vec2<f32>,
    conic: vec3<f32>,
    colour: vec3<f32>,
    // By the logit of the opacity.
    logit: f32,
}

fn sum_slots(first: u32, count: u32, p: Projection, opacity: f32) -> SlotSum {
    var colour = vec4<f32>(0.0);
    var moments = vec4<f32>(0.0);
    var tail = 0.0;
    let tails = arrayLength(&slot_words) / 2u;
    for (var slot = first; slot < first + count; slot++) {
        colour += slot_colours[slot];
        moments += slot_moments[slot];
        tail += slot_words[tails + slot];
    }
    // sigma = 0.5 (a dx^2 + c dy^2) + b dx dy, alpha = opacity exp(-sigma): what all slots of a
    // Gaussian share is put in here.
    let conic = vec3<f32>(p.flat.z, -p.flat.y, p.flat.x) / p.determinant;
    let mean = -vec2<f32>(dot(conic.xy, moments.xy), dot(conic.yz, moments.xy));
    return SlotSum(mean, vec3<f32>(0.5 * moments.z, moments.w, 0.5 * tail), colour.xyz,
        -colour.w * (1.0 - opacity));
}

fn geometry_backward(p: Projection, s: Shape, sum: SlotSum, by_direction: vec3<f32>) -> Geometry {
    let by_flat = conic_backward(p, sum.conic);
    let by_covariance = transpose(p.linear) * by_flat * p.linear;
    let by_linear = 2.0 * (by_flat * p.linear * s.covariance);
    let by_point = point_backward(p, sum.mean, by_linear * transpose(p.to_camera));
    let by_mean = transpose(p.to_camera) * by_point + by_direction;
    let by_factor = 2.0 * (by_covariance * scaled_columns(s.rotation, s.scale));
    let by_scale = vec3<f32>(
        dot(by_factor[0], s.rotation[0]),
        dot(by_factor[1], s.rotation[1]),
        dot(by_factor[2], s.rotation[2]),
    );
    let by_rotation = scaled_columns(by_factor, s.scale);
    return Geometry(by_mean, by_scale * s.scale, quat_backward(s, by_rotation), sum.logit);
}

// The colour's gradient behind the clamp at 0, and the mean's share of it through the direction.
struct ColourGradient {
    gated: vec3<f32>,
    by_mean: vec3<f32>,
}

// Four slopes, weighed by how four coefficients go along the gradient.
fn along(
    gradient: vec3<f32>,
    m: mat4x3<f32>,
    s0: vec3<f32>,
    s1: vec3<f32>,
    s2: vec3<f32>,
    s3: vec3<f32>,
) -> vec3<f32> {
    let w = gradient * m;
    return w.x * s0 + w.y * s1 + w.z * s2 + w.w * s3;
}

fn colour_backward(
    v: array<vec4<f32>, 12>,
    basis: array<f32, 16>,
    offset: vec3<f32>,
    by_colour: vec3<f32>,
) -> ColourGradient {
    let distance = max(length(offset), 1e-12);
    let direction = offset / distance;
    let s = sh_slopes(direction, camera.sh_degree);
    let gated = select(vec3<f32>(0.0), by_colour, harmonics_colour(v, basis) > vec3<f32>(0.0));
    let by_direction = along(gated, coefficients(v[0], v[1], v[2]), s[0], s[1], s[2], s[3])
        + along(gated, coefficients(v[3], v[4], v[5]), s[4], s[5], s[6], s[7])
        + along(gated, coefficients(v[6], v[7], v[8]), s[8], s[9], s[10], s[11])
        + along(gated, coefficients(v[9], v[10], v[11]), s[12], s[13], s[14], s[15]);
    return ColourGradient(gated,
        (by_direction - direction * dot(direction, by_direction)) / distance);
}

// Adam's update, subtracted from the parameters.
fn adam_step(m: vec4<f32>, v: vec4<f32>, rate: vec4<f32>) -> vec4<f32> {
    return rate * m * train.bias_m / (sqrt(v * train.bias_v) + EPSILON);
}

fn update_geometry(row: u32, q: u32, value: vec4<f32>, gradient: vec4<f32>, rate: vec4<f32>) {
    let at = 6u * row + q;
    if (WRITE_GRADIENTS == 1u) {
        geometry_moments[at] = gradient;
        return;
    }
    let m = BETA_M * geometry_moments[at] + (1.0 - BETA_M) * gradient;
    let v = BETA_V * geometry_moments[at + 3u] + (1.0 - BETA_V) * gradient * gradient;
    geometry_moments[at] = m;
    geometry_moments[at + 3u] = v;
    geometry[3u * row + q] = value - adam_step(m, v, rate);
}

// The vector with the logit; its last floats are not parameters but hold the position's gradient.
fn update_logit(row: u32, value: vec4<f32>, gradient: vec4<f32>, rate: vec4<f32>, seen: vec2<f32>) {
    let at = 6u * row + 2u;
    let before = vec2<f32>(geometry_moments[at].w, geometry_moments[at + 3u].w);
    update_geometry(row, 2u, value, gradient, rate);
    if (ACCUMULATE_POSITION == 1u) {
        geometry_moments[at].w = before.x + seen.x;
        geometry_moments[at + 3u].w = before.y + seen.y;
    }
}

fn update_harmonics(row: u32, q: u32, value: vec4<f32>, gradient: vec4<f32>, rate: vec4<f32>) {
    let at = 2u * row * camera.sh_row + q;
    if (WRITE_GRADIENTS == 1u) {
        sh_moments[at] = gradient;
        return;
    }
    let m = BETA_M * sh_moments[at] + (1.0 - BETA_M) * gradient;
    let v = BETA_V * sh_moments[at + camera.sh_row] + (1.0 - BETA_V) * gradient * gradient;
    sh_moments[at] = m;
    sh_moments[at + camera.sh_row] = v;
    sh[row * camera.sh_row + q] = value - adam_step(m, v, rate);
}

// Three vectors of four coefficients.
fn update_block(row: u32, q: u32, a: vec4<f32>, b: vec4<f32>, c: vec4<f32>, g: mat4x3<f32>) {
    let rate = vec4<f32>(train.rate_sh);
    let base = select(rate, vec4<f32>(vec3<f32>(train.rate_sh0), train.rate_sh), q == 0u);
    update_harmonics(row, q, a, vec4<f32>(g[0], g[1].x), base);
    update_harmonics(row, q + 1u, b, vec4<f32>(g[1].yz, g[2].xy), rate);
    update_harmonics(row, q + 2u, c, vec4<f32>(g[2].z, g[3]), rate);
}

// Inactive coefficients have no gradient and no moments, so they stay.
fn update_colour(row: u32, v: array<vec4<f32>, 12>, b: array<f32, 16>, gated: vec3<f32>) {
    let first = mat4x3<f32>(gated * b[0], gated * b[1], gated * b[2], gated * b[3]);
    if (camera.sh_degree == 0u) {
        let rate = vec4<f32>(vec3<f32>(train.rate_sh0), 0.0);
        update_harmonics(row, 0u, v[0], vec4<f32>(first[0], 0.0), rate);
        return;
    }
    update_block(row, 0u, v[0], v[1], v[2], first);
    if (camera.sh_degree >= 2u) {
        update_block(row, 3u, v[3], v[4], v[5],
            mat4x3<f32>(gated * b[4], gated * b[5], gated * b[6], gated * b[7]));
    }
    if (camera.sh_degree == 2u) {
        update_harmonics(row, 6u, v[6], vec4<f32>(gated * b[8], 0.0), vec4<f32>(train.rate_sh));
    }
    if (camera.sh_degree >= 3u) {
        let third = mat4x3<f32>(gated * b[8], gated * b[9], gated * b[10], gated * b[11]);
        update_block(row, 6u, v[6], v[7], v[8], third);
        let last = mat4x3<f32>(gated * b[12], gated * b[13], gated * b[14], gated * b[15]);
        update_block(row, 9u, v[9], v[10], v[11], last);
    }
}

// The largest log-scales by which no axis recedes too far from the camera.
fn deepest(p: Projection, s: Shape) -> vec3<f32> {
    let axes = p.to_camera * s.rotation;
    let recede = abs(vec3<f32>(axes[0].z, axes[1].z, axes[2].z));
    return log(DEEPEST * p.point.z / max(recede, vec3<f32>(1e-6)));
}

// Exploration of MCMC: a normal step shaped by the covariance, large where the opacity is small.
fn exploration(i: u32, s: Shape) -> vec3<f32> {
    let gate = sigmoid(-100.0 * (s.opacity - 0.005));
    let move_by = s.covariance * normal3(train.seed, train.step, i) * (gate * train.noise);
    return select(vec3<f32>(0.0), move_by, is_finite3(move_by));
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    let i = part.first + row;
    let intersections = atomicLoad(&spans[0]);
    if (row >= part.rows || i >= camera.count || intersections > train.capacity) {
        return;
    }
    let g = load_geometry(row);
    if (!geometry_usable(g)) {
        return;
    }
    let shape = shape_of(g);
    let p = project_shape(g.mean, shape, camera);
    let offset = g.mean - camera.position;
    let harmonics = load_harmonics(row);
    let basis = sh_basis(offset / max(length(offset), 1e-12), camera.sh_degree);
    var by = Geometry(vec3<f32>(0.0), vec3<f32>(0.0), vec4<f32>(0.0), 0.0);
    var gated = vec3<f32>(0.0);
    var seen = vec2<f32>(0.0);
    let touched = atomicLoad(&spans[2u * i + 3u]);
    if (touched > 0u && p.usable) {
        let sum = sum_slots(atomicLoad(&spans[2u * i + 2u]), touched, p, shape.opacity);
        let colour = colour_backward(harmonics, basis, offset, sum.colour);
        by = geometry_backward(p, shape, sum, colour.by_mean);
        gated = colour.gated;
        seen = vec2<f32>(length(0.5 * vec2<f32>(camera.size) * sum.mean), 1.0);
    }
    if (!(fits3(by.mean) && fits3(by.log_scale) && fits3(by.quat.xyz) && fits3(gated)
        && fits3(vec3<f32>(by.quat.w, by.logit, 0.0)))) {
        atomicAdd(&spans[1], 1u);
        return;
    }
    by.logit += train.opacity_weight * shape.opacity * (1.0 - shape.opacity);
    by.log_scale += train.scale_weight * shape.scale;
    let held = clamp(g.log_scale, vec3<f32>(LOG_SCALE_LOW), vec3<f32>(LOG_SCALE_HIGH));
    by.log_scale = select(vec3<f32>(0.0), by.log_scale, g.log_scale == held);
    var mean = g.mean;
    if (WRITE_GRADIENTS == 0u && train.noise > 0.0) {
        mean += exploration(i, shape);
    }
    let rates = train.rates;
    let s = select(g.log_scale, min(g.log_scale, deepest(p, shape)), touched > 0u);
    update_geometry(row, 0u, vec4<f32>(mean, s.x), vec4<f32>(by.mean, by.log_scale.x), rates.xxxy);
    update_geometry(row, 1u, vec4<f32>(s.yz, g.quat.xy), vec4<f32>(by.log_scale.yz, by.quat.xy),
        rates.yyzz);
    let last = vec4<f32>(g.quat.zw, g.logit, 0.0);
    let by_last = vec4<f32>(by.quat.zw, by.logit, 0.0);
    update_logit(row, last, by_last, vec4<f32>(rates.zzw, 0.0), seen);
    update_colour(row, harmonics, basis, gated);
}
