// The derivative of the loss by one weighted sum of light an invocation.
// Reads gradient [3, H, W] (by blurred). Reads and writes factor [3, H, W]. Dispatch: 3 H W.
// factor *= gradient.
#import shared/grid.wgsl
#import shared/shake.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> shake: ShakeUniform;
@group(0) @binding(1) var<storage, read> gradient: array<f32>;
@group(0) @binding(2) var<storage, read_write> factor: array<f32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    if index < shake.values {
        factor[index] *= gradient[index];
    }
}
