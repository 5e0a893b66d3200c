// The gradient of one Gaussian an invocation, from its slots to its parameters, and its Adam update in
// place. Sums the Gaussian's contiguous rows of slot_gradients, goes back through conic, covariance,
// projection, harmonics and activations, adds the MCMC regularisers, updates, adds exploration noise.
// Reads tile_counts, slot_offsets [count], slot_means (mean2d xy, opacity), slot_conics (abc), slot_colours (rgb), all
// [slots, 3], intersections (their exact total). Reads and writes geometry [part, 12], geometry_moments [part, 2, 12],
// sh [part, coefficients, 3], sh_moments [part, 2, coefficients, 3], counters [0] (non-finite gradients dropped).
// Dispatch: the part's rows. Void when the slots overflowed.
// WRITE_GRADIENTS = 1 leaves the parameters and writes the gradient in place of the first moments. COUNT_PULLS = 1 adds
// the length of the gradient by the position, in normalised device coordinates, and a view to the moments' free floats.
#import shared/grid.wgsl
#import shared/harmonics.wgsl
#import shared/part.wgsl
#import shared/projection_backward.wgsl
#import shared/random.wgsl
#import shared/train.wgsl

const WIDTH: u32 = 64;
const WRITE_GRADIENTS: u32 = 0;
const COUNT_PULLS: u32 = 0;
const BETA_M: f32 = 0.9;
const BETA_V: f32 = 0.999;
const EPSILON: f32 = 1e-15;

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<uniform> train: StepUniform;
@group(0) @binding(2) var<uniform> part: PartUniform;
@group(0) @binding(3) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(4) var<storage, read> slot_offsets: array<u32>;
@group(0) @binding(5) var<storage, read> slot_means: array<f32>;
@group(0) @binding(6) var<storage, read> slot_conics: array<f32>;
@group(0) @binding(7) var<storage, read> slot_colours: array<f32>;
@group(0) @binding(8) var<storage, read> intersections: array<u32>;
@group(0) @binding(9) var<storage, read_write> geometry: array<f32>;
@group(0) @binding(10) var<storage, read_write> geometry_moments: array<f32>;
@group(0) @binding(11) var<storage, read_write> sh: array<f32>;
@group(0) @binding(12) var<storage, read_write> sh_moments: array<f32>;
@group(0) @binding(13) var<storage, read_write> counters: array<atomic<u32>>;

// Finite, and so small that its square is finite too: by bits, for NaN has no order in WGSL.
fn fits3(v: vec3<f32>) -> bool {
    let bits = bitcast<vec3<u32>>(v) & vec3<u32>(0x7fffffffu);
    // 0x5d5e0b6b is 1e18.
    return all(bits < vec3<u32>(0x5d5e0b6bu));
}

struct SlotSum {
    mean: vec2<f32>,
    conic: vec3<f32>,
    colour: vec3<f32>,
    opacity: f32,
}

fn load_geometry(row: u32) -> Geometry {
    let at = row * 12u;
    return Geometry(
        vec3<f32>(geometry[at], geometry[at + 1u], geometry[at + 2u]),
        vec3<f32>(geometry[at + 3u], geometry[at + 4u], geometry[at + 5u]),
        vec4<f32>(geometry[at + 6u], geometry[at + 7u], geometry[at + 8u], geometry[at + 9u]),
        geometry[at + 10u],
    );
}

fn sum_slots(i: u32) -> SlotSum {
    var sum = SlotSum(vec2<f32>(0.0), vec3<f32>(0.0), vec3<f32>(0.0), 0.0);
    let first = slot_offsets[i];
    for (var slot = first; slot < first + tile_counts[i]; slot++) {
        let at = slot * 3u;
        sum.mean += vec2<f32>(slot_means[at], slot_means[at + 1u]);
        sum.conic += vec3<f32>(slot_conics[at], slot_conics[at + 1u], slot_conics[at + 2u]);
        sum.colour += vec3<f32>(slot_colours[at], slot_colours[at + 1u], slot_colours[at + 2u]);
        sum.opacity += slot_means[at + 2u];
    }
    return sum;
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
    let by_logit = sum.opacity * s.opacity * (1.0 - s.opacity) / (1.0 - camera.dropout);
    return Geometry(by_mean, by_scale * s.scale, quat_backward(s, by_rotation), by_logit);
}

// The colour's gradient behind the clamp at 0, and the mean's share of it through the direction.
struct ColourGradient {
    gated: vec3<f32>,
    by_mean: vec3<f32>,
}

fn colour_backward(row: u32, mean: vec3<f32>, by_colour: vec3<f32>) -> ColourGradient {
    let offset = mean - camera.position;
    let distance = max(length(offset), 1e-12);
    let direction = offset / distance;
    var basis = sh_basis(direction);
    var slopes = sh_slopes(direction);
    let used = min(sh_count(camera.sh_degree), camera.coefficients);
    var colour = vec3<f32>(0.5);
    var jacobian = mat3x3<f32>();
    var at = row * camera.coefficients * 3u;
    for (var k = 0u; k < used; k++) {
        let value = vec3<f32>(sh[at], sh[at + 1u], sh[at + 2u]);
        colour += basis[k] * value;
        jacobian += mat3x3<f32>(slopes[k] * value.x, slopes[k] * value.y, slopes[k] * value.z);
        at += 3u;
    }
    let gated = select(vec3<f32>(0.0), by_colour, colour > vec3<f32>(0.0));
    let by_direction = jacobian * gated;
    return ColourGradient(gated, (by_direction - direction * dot(direction, by_direction)) / distance);
}

fn adam_geometry(row: u32, slot: u32, gradient: f32, rate: f32) {
    let at = row * 24u + slot;
    if (WRITE_GRADIENTS == 1u) {
        geometry_moments[at] = gradient;
        return;
    }
    let m = BETA_M * geometry_moments[at] + (1.0 - BETA_M) * gradient;
    let v = BETA_V * geometry_moments[at + 12u] + (1.0 - BETA_V) * gradient * gradient;
    geometry_moments[at] = m;
    geometry_moments[at + 12u] = v;
    geometry[row * 12u + slot] -= rate * m * train.bias_m / (sqrt(v * train.bias_v) + EPSILON);
}

fn adam_sh(row: u32, slot: u32, gradient: f32, rate: f32) {
    let length = camera.coefficients * 3u;
    let at = row * 2u * length + slot;
    if (WRITE_GRADIENTS == 1u) {
        sh_moments[at] = gradient;
        return;
    }
    let m = BETA_M * sh_moments[at] + (1.0 - BETA_M) * gradient;
    let v = BETA_V * sh_moments[at + length] + (1.0 - BETA_V) * gradient * gradient;
    sh_moments[at] = m;
    sh_moments[at + length] = v;
    sh[row * length + slot] -= rate * m * train.bias_m / (sqrt(v * train.bias_v) + EPSILON);
}

fn update_geometry(row: u32, g: Geometry) {
    for (var axis = 0u; axis < 3u; axis++) {
        adam_geometry(row, axis, g.mean[axis], train.rates.x);
        adam_geometry(row, 3u + axis, g.log_scale[axis], train.rates.y);
    }
    for (var axis = 0u; axis < 4u; axis++) {
        adam_geometry(row, 6u + axis, g.quat[axis], train.rates.z);
    }
    adam_geometry(row, 10u, g.logit, train.rates.w);
}

fn count_pull(row: u32, by_mean: vec2<f32>) {
    let pull = length(0.5 * vec2<f32>(camera.size) * by_mean);
    geometry_moments[row * 24u + 11u] += pull;
    geometry_moments[row * 24u + 23u] += 1.0;
}

// Inactive coefficients have no gradient and no moments, so they are left alone.
fn update_sh(row: u32, mean: vec3<f32>, gated: vec3<f32>) {
    let offset = mean - camera.position;
    var basis = sh_basis(offset / max(length(offset), 1e-12));
    let used = min(sh_count(camera.sh_degree), camera.coefficients);
    for (var k = 0u; k < used; k++) {
        let rate = select(train.rate_sh, train.rate_sh0, k == 0u);
        for (var c = 0u; c < 3u; c++) {
            adam_sh(row, 3u * k + c, gated[c] * basis[k], rate);
        }
    }
}

// Exploration of MCMC: a normal step shaped by the covariance, large where the opacity is small.
fn explore(row: u32, s: Shape) {
    let gate = sigmoid(-100.0 * (s.opacity - 0.005));
    let move_by = s.covariance * normal3(train.seed, train.step, part.first + row) * (gate * train.noise);
    if (is_finite3(move_by)) {
        for (var axis = 0u; axis < 3u; axis++) {
            geometry[row * 12u + axis] += move_by[axis];
        }
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    let i = part.first + row;
    if (row >= part.rows || i >= camera.count || intersections[train.total_at] > train.capacity) {
        return;
    }
    let g = load_geometry(row);
    if (!geometry_usable(g)) {
        return;
    }
    let shape = shape_of(g);
    let p = project_shape(g.mean, shape, camera);
    var by = Geometry(vec3<f32>(0.0), vec3<f32>(0.0), vec4<f32>(0.0), 0.0);
    var gated = vec3<f32>(0.0);
    var pull = vec2<f32>(0.0);
    if (tile_counts[i] > 0u && p.usable) {
        let sum = sum_slots(i);
        let colour = colour_backward(row, g.mean, sum.colour);
        by = geometry_backward(p, shape, sum, colour.by_mean);
        gated = colour.gated;
        pull = sum.mean;
    }
    if (!(fits3(by.mean) && fits3(by.log_scale) && fits3(by.quat.xyz) && fits3(gated)
        && fits3(vec3<f32>(by.quat.w, by.logit, 0.0)))) {
        atomicAdd(&counters[0], 1u);
        return;
    }
    by.logit += train.opacity_weight * shape.opacity * (1.0 - shape.opacity);
    by.log_scale += train.scale_weight * shape.scale;
    let held = clamp(g.log_scale, vec3<f32>(LOG_SCALE_LOW), vec3<f32>(LOG_SCALE_HIGH));
    by.log_scale = select(vec3<f32>(0.0), by.log_scale, g.log_scale == held);
    update_geometry(row, by);
    update_sh(row, g.mean, gated);
    if (COUNT_PULLS == 1u && tile_counts[i] > 0u) {
        count_pull(row, pull);
    }
    if (WRITE_GRADIENTS == 0u && train.noise > 0.0) {
        explore(row, shape);
    }
}
