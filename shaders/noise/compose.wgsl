// Adds the noise to one pixel of the render an invocation.
// Reads raw [H W, 4], render [3, H, W]. Writes prediction [3, H, W]. Dispatch: H W.
// prediction = render + n, n = A sigmoid(raw).
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> field: NoiseUniform;
@group(0) @binding(1) var<storage, read> raw: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> render: array<f32>;
@group(0) @binding(3) var<storage, read_write> prediction: array<f32>;

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
    let n = noise_of(raw[index], field.amplitude);
    prediction[index] = render[index] + n.x;
    prediction[index + pixels] = render[index + pixels] + n.y;
    prediction[index + 2u * pixels] = render[index + 2u * pixels] + n.z;
}
