// Adds the noise to one pixel of the render an invocation.
// Reads values [cells, 4], mean [1], render [3, H, W]. Writes prediction [3, H, W]. Dispatch: H W.
// prediction = render + bilinear(n) - mean(n).
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> field: NoiseUniform;
@group(0) @binding(1) var<storage, read> values: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> mean: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> render: array<f32>;
@group(0) @binding(4) var<storage, read_write> prediction: array<f32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    let pixels = field.width * field.height;
    if index >= pixels {
        return;
    }
    let x = cell_position(index % field.width, field.scale, field.columns);
    let y = cell_position(index / field.width, field.scale, field.rows);
    let left = u32(x);
    let top = u32(y) * field.columns;
    let right = min(left + 1u, field.columns - 1u);
    let bottom = min(u32(y) + 1u, field.rows - 1u) * field.columns;
    let above = mix(values[top + left], values[top + right], fract(x));
    let below = mix(values[bottom + left], values[bottom + right], fract(x));
    let n = mix(above, below, fract(y)) - mean[0];
    prediction[index] = render[index] + n.x;
    prediction[index + pixels] = render[index + pixels] + n.y;
    prediction[index + 2u * pixels] = render[index + 2u * pixels] + n.z;
}
