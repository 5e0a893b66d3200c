// The derivative of the loss by the weighted sums of light of one pixel an invocation.
// Reads gradient [3, H, W] (by blurred). Reads and writes factor [H, W]. Dispatch: H W.
// factor *= gradient.
#import shared/grid.wgsl
#import shared/shake.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> shake: ShakeUniform;
@group(0) @binding(1) var<storage, read> gradient: array<f32>;
@group(0) @binding(2) var<storage, read_write> factor: array<vec4<f32>>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    let pixels = shake.width * shake.height;
    if index >= pixels {
        return;
    }
    let by_blurred =
        vec3<f32>(gradient[index], gradient[index + pixels], gradient[index + 2u * pixels]);
    factor[index] *= vec4<f32>(by_blurred, 0.0);
}
