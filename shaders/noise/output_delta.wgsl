// The derivative by the network's output of one cell of the chunk an invocation.
// Reads values [cells, 4], cell_gradient [cells, 4], total [1]. Writes delta [count, 4]. Dispatch:
// count.
// dn = g - share * sum g (centred) or g; delta = dn A (1 - tanh^2) or dn A sigmoid (1 - sigmoid).
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> field: NoiseUniform;
@group(0) @binding(1) var<uniform> chunk: ChunkUniform;
@group(0) @binding(2) var<storage, read> values: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> cell_gradient: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> total: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> delta: array<vec4<f32>>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    if index >= chunk.count {
        return;
    }
    let value = values[chunk.first + index];
    let n = value.xyz;
    var dn = cell_gradient[chunk.first + index].xyz;
    var slope = n * (1.0 - n / field.amplitude);
    if field.centred == 1u {
        dn -= value.w * total[0].xyz;
        slope = field.amplitude - n * n / field.amplitude;
    }
    delta[index] = vec4<f32>(dn * slope, 0.0);
}
