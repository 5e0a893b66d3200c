// The roofline of memory: copies 16 bytes an invocation.
// Reads size, source [4 count]. Writes copied [4 count]. Dispatch: count.
// 32 bytes an invocation: 16 read and 16 written.
#import shared/grid.wgsl

const WIDTH: u32 = 64;

struct RooflineUniform {
    count: u32,
    rounds: u32,
    factor: f32,
    offset: f32,
}

@group(0) @binding(0) var<uniform> size: RooflineUniform;
@group(0) @binding(1) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> copied: array<vec4<f32>>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    if (i < size.count) {
        copied[i] = source[i];
    }
}
