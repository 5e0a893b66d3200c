// The yardstick of arithmetic: CHAINS independent chains of fused multiply-adds, 4 wide, an invocation.
// Reads size. Writes sums [4 count], so that nothing can be left out. Dispatch: count.
// x <- a x + b, `rounds` times: 2 * 4 * CHAINS * rounds operations an invocation.
#import shared/grid.wgsl

const WIDTH: u32 = 64;
const CHAINS: u32 = 8;

struct YardstickUniform {
    count: u32,
    rounds: u32,
    factor: f32,
    offset: f32,
}

@group(0) @binding(0) var<uniform> size: YardstickUniform;
@group(0) @binding(1) var<storage, read_write> sums: array<vec4<f32>>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    if (i >= size.count) {
        return;
    }
    let a = vec4<f32>(size.factor);
    let b = vec4<f32>(size.offset);
    let start = vec4<f32>(f32(i), f32(lane), 1.0, 2.0);
    var x0 = start;
    var x1 = start + 1.0;
    var x2 = start + 2.0;
    var x3 = start + 3.0;
    var x4 = start + 4.0;
    var x5 = start + 5.0;
    var x6 = start + 6.0;
    var x7 = start + 7.0;
    for (var round = 0u; round < size.rounds; round++) {
        x0 = fma(x0, a, b);
        x1 = fma(x1, a, b);
        x2 = fma(x2, a, b);
        x3 = fma(x3, a, b);
        x4 = fma(x4, a, b);
        x5 = fma(x5, a, b);
        x6 = fma(x6, a, b);
        x7 = fma(x7, a, b);
    }
    sums[i] = ((x0 + x1) + (x2 + x3)) + ((x4 + x5) + (x6 + x7));
}
