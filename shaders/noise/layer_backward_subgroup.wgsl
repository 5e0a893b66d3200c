// The derivative by the input of one fully connected layer, for 16 pixels a subgroup and 4 inputs a
// lane; as layer_forward_subgroup.wgsl.
// Reads delta [count, output_stride] (the derivative before the relu of the layer), parameters,
// input [count, input_stride]. Writes input_delta [count, input_stride]. Dispatch: a workgroup for
// 16 cells and 32 inputs.
// input_delta = delta W^T, 0 where the input came out of a relu as 0.
#import shared/grid.wgsl
#import shared/noise.wgsl

// Lanes of a subgroup.
const SUBGROUP: u32 = 8;

@group(0) @binding(0) var<uniform> layer: LayerUniform;
@group(0) @binding(1) var<uniform> chunk: ChunkUniform;
@group(0) @binding(2) var<storage, read> delta: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> parameters: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> input_delta: array<vec4<f32>>;

// The weights of four outputs and four inputs, a row an input.
fn weights(at: u32) -> mat4x4<f32> {
    let stride = layer.outputs;
    return transpose(mat4x4<f32>(
        parameters[at],
        parameters[at + stride],
        parameters[at + 2u * stride],
        parameters[at + 3u * stride],
    ));
}

fn store(at: u32, value: vec4<f32>) {
    let passes = (input[at] > vec4<f32>(0.0)) | vec4<bool>(layer.input_relu == 0u);
    input_delta[at] = select(vec4<f32>(0.0), value, passes);
}

@compute @workgroup_size(SUBGROUP)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let index = flat_workgroup(workgroup, workgroups);
    let across = (layer.inputs + SUBGROUP - 1u) / SUBGROUP;
    let mine = (index % across) * SUBGROUP + lane;
    let row = (index / across) * 16u;
    if (row >= chunk.count) {
        return;
    }
    // Lanes past the last input compute it too, and do not store it.
    let column = min(mine, layer.inputs - 1u);
    var a0 = vec4<f32>(0.0);
    var a1 = vec4<f32>(0.0);
    var a2 = vec4<f32>(0.0);
    var a3 = vec4<f32>(0.0);
    var a4 = vec4<f32>(0.0);
    var a5 = vec4<f32>(0.0);
    var a6 = vec4<f32>(0.0);
    var a7 = vec4<f32>(0.0);
    var a8 = vec4<f32>(0.0);
    var a9 = vec4<f32>(0.0);
    var a10 = vec4<f32>(0.0);
    var a11 = vec4<f32>(0.0);
    var a12 = vec4<f32>(0.0);
    var a13 = vec4<f32>(0.0);
    var a14 = vec4<f32>(0.0);
    var a15 = vec4<f32>(0.0);
    let lower = (row + lane) * layer.output_stride;
    let upper = lower + SUBGROUP * layer.output_stride;
    for (var k = 0u; k < layer.outputs; k++) {
        let w = weights(layer.weights + 4u * column * layer.outputs + k);
        let x = delta[lower + k];
        let y = delta[upper + k];
        a0 += w * subgroupBroadcast(x, 0u);
        a1 += w * subgroupBroadcast(x, 1u);
        a2 += w * subgroupBroadcast(x, 2u);
        a3 += w * subgroupBroadcast(x, 3u);
        a4 += w * subgroupBroadcast(x, 4u);
        a5 += w * subgroupBroadcast(x, 5u);
        a6 += w * subgroupBroadcast(x, 6u);
        a7 += w * subgroupBroadcast(x, 7u);
        a8 += w * subgroupBroadcast(y, 0u);
        a9 += w * subgroupBroadcast(y, 1u);
        a10 += w * subgroupBroadcast(y, 2u);
        a11 += w * subgroupBroadcast(y, 3u);
        a12 += w * subgroupBroadcast(y, 4u);
        a13 += w * subgroupBroadcast(y, 5u);
        a14 += w * subgroupBroadcast(y, 6u);
        a15 += w * subgroupBroadcast(y, 7u);
    }
    if (mine >= layer.inputs) {
        return;
    }
    let to = row * layer.input_stride + column;
    store(to + 0u * layer.input_stride, a0);
    store(to + 1u * layer.input_stride, a1);
    store(to + 2u * layer.input_stride, a2);
    store(to + 3u * layer.input_stride, a3);
    store(to + 4u * layer.input_stride, a4);
    store(to + 5u * layer.input_stride, a5);
    store(to + 6u * layer.input_stride, a6);
    store(to + 7u * layer.input_stride, a7);
    store(to + 8u * layer.input_stride, a8);
    store(to + 9u * layer.input_stride, a9);
    store(to + 10u * layer.input_stride, a10);
    store(to + 11u * layer.input_stride, a11);
    store(to + 12u * layer.input_stride, a12);
    store(to + 13u * layer.input_stride, a13);
    store(to + 14u * layer.input_stride, a14);
    store(to + 15u * layer.input_stride, a15);
}
