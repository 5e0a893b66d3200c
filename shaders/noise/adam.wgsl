// One step of Adam on four parameters of the noise field an invocation.
// Reads intersections (their exact total), gradients [segments, parameters]. Writes parameters,
// moments [2, parameters]. Dispatch: parameters.
// m = b1 m + (1 - b1) g, v = b2 v + (1 - b2) g^2, p -= rate m / c1 / (sqrt(v / c2) + eps).
#import shared/grid.wgsl

const WIDTH: u32 = 32;
const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-8;

struct AdamUniform {
    // Learning rate of this step; 1 - b1^t and 1 - b2^t.
    rate: f32,
    correction_1: f32,
    correction_2: f32,
    // Parts of the gradient, and vec4s of parameters.
    segments: u32,
    parameters: u32,
    // Index of the number of intersections, and the capacity.
    total_at: u32,
    capacity: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> adam: AdamUniform;
@group(0) @binding(1) var<storage, read> intersections: array<u32>;
@group(0) @binding(2) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> parameters: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> moments: array<vec4<f32>>;

// Infinities and NaN have all bits of the exponent set; they count as no gradient.
fn finite(v: vec4<f32>) -> vec4<f32> {
    let exponent = bitcast<vec4<u32>>(v) & vec4<u32>(0x7f800000u);
    return select(v, vec4<f32>(0.0), exponent == vec4<u32>(0x7f800000u));
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    // A render of only some intersections gives no valid gradient; the step is repeated.
    if index >= adam.parameters || intersections[adam.total_at] > adam.capacity {
        return;
    }
    var gradient = vec4<f32>(0.0);
    for (var segment = 0u; segment < adam.segments; segment++) {
        gradient += gradients[segment * adam.parameters + index];
    }
    gradient = finite(gradient);
    let m = BETA_1 * moments[index] + (1.0 - BETA_1) * gradient;
    let v = BETA_2 * moments[adam.parameters + index] + (1.0 - BETA_2) * gradient * gradient;
    moments[index] = m;
    moments[adam.parameters + index] = v;
    parameters[index] -= adam.rate * (m / adam.correction_1)
        / (sqrt(v / adam.correction_2) + EPSILON);
}
