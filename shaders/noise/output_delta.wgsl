// The derivative by the network's output at one pixel of the chunk an invocation.
// Reads raw [H W, 4], gradient [3, H, W]. Writes delta [count, 4]. Dispatch: count.
// delta = dL/dprediction A sigmoid (1 - sigmoid).
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> field: NoiseUniform;
@group(0) @binding(1) var<uniform> chunk: ChunkUniform;
@group(0) @binding(2) var<storage, read> raw: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> gradient: array<f32>;
@group(0) @binding(4) var<storage, read_write> delta: array<vec4<f32>>;

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
    let pixel = chunk.first + index;
    let pixels = field.width * field.height;
    let g = vec3<f32>(gradient[pixel], gradient[pixel + pixels], gradient[pixel + 2u * pixels]);
    let n = noise_of(raw[pixel], field.amplitude);
    delta[index] = vec4<f32>(g * (n * (1.0 - n / field.amplitude)), 0.0);
}
