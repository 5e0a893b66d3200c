// The example kernel of the crate `fled-gpu`: out[i] += factor * ADD * x[i].
// One invocation an element. Reads scale, x [count]; reads and writes out [count]. Dispatch: count.
#import shared/grid.wgsl
#import shared/test_scale.wgsl

const ADD: u32 = 1;
const WIDTH: u32 = 64;

@group(0) @binding(0) var<uniform> scale: TestScale;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    if i < scale.count {
        out[i] += scale.factor * f32(ADD) * x[i];
    }
}
