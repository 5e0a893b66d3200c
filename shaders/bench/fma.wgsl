// The roofline of arithmetic: three independent chains of fused multiply-adds, 4 wide, an
// invocation. More would not fit the registers of a CPU.
// Reads size. Writes sums [4 count], so that nothing can be left out. Dispatch: count.
// x <- a x + b: FMAS a round, 8 operations each, `rounds` rounds an invocation.
#import shared/grid.wgsl

const WIDTH: u32 = 64;
const FMAS: u32 = 24;

struct RooflineUniform {
    count: u32,
    rounds: u32,
    factor: f32,
    offset: f32,
}

@group(0) @binding(0) var<uniform> size: RooflineUniform;
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
    var x = start;
    var y = start + 1.0;
    var z = start + 2.0;
    for (var round = 0u; round < size.rounds; round++) {
        x = fma(fma(fma(fma(x, a, b), a, b), a, b), a, b);
        y = fma(fma(fma(fma(y, a, b), a, b), a, b), a, b);
        z = fma(fma(fma(fma(z, a, b), a, b), a, b), a, b);
        x = fma(fma(fma(fma(x, a, b), a, b), a, b), a, b);
        y = fma(fma(fma(fma(y, a, b), a, b), a, b), a, b);
        z = fma(fma(fma(fma(z, a, b), a, b), a, b), a, b);
    }
    sums[i] = x + y + z;
}
