// One fully connected layer for 16 pixels a subgroup and 4 outputs a lane: a lane loads two pixels'
// inputs, and all lanes get them from it. What layer_forward.wgsl does where a load costs more than
// an exchange.
// Reads input [count, input_stride], parameters. Writes output [count, output_stride]. Rows past
// count, up to a multiple of 16, are written with nothing of meaning. Dispatch: a workgroup for 16
// pixels and 32 outputs.
// output = relu(input W + b), or without the relu.
#import shared/grid.wgsl
#import shared/noise.wgsl

// Lanes of a subgroup.
const SUBGROUP: u32 = 8;

@group(0) @binding(0) var<uniform> layer: LayerUniform;
@group(0) @binding(1) var<uniform> chunk: ChunkUniform;
@group(0) @binding(2) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> parameters: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> output: array<vec4<f32>>;

// The weights of four inputs and four outputs, a column an input.
fn weights(at: u32) -> mat4x4<f32> {
    let stride = layer.outputs;
    return mat4x4<f32>(
        parameters[at],
        parameters[at + stride],
        parameters[at + 2u * stride],
        parameters[at + 3u * stride],
    );
}

fn store(at: u32, value: vec4<f32>) {
    output[at] = max(value, vec4<f32>(select(-3.4e38, 0.0, layer.relu == 1u)));
}

@compute @workgroup_size(SUBGROUP)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let index = flat_workgroup(workgroup, workgroups);
    let across = (layer.outputs + SUBGROUP - 1u) / SUBGROUP;
    let mine = (index % across) * SUBGROUP + lane;
    let row = (index / across) * 16u;
    if (row >= chunk.count) {
        return;
    }
    // Lanes past the last output compute it too, and do not store it.
    let column = min(mine, layer.outputs - 1u);
    let bias = parameters[layer.biases + column];
    var a0 = bias;
    var a1 = bias;
    var a2 = bias;
    var a3 = bias;
    var a4 = bias;
    var a5 = bias;
    var a6 = bias;
    var a7 = bias;
    var a8 = bias;
    var a9 = bias;
    var a10 = bias;
    var a11 = bias;
    var a12 = bias;
    var a13 = bias;
    var a14 = bias;
    var a15 = bias;
    let lower = (row + lane) * layer.input_stride;
    let upper = lower + SUBGROUP * layer.input_stride;
    for (var k = 0u; k < layer.inputs; k++) {
        let w = weights(layer.weights + 4u * k * layer.outputs + column);
        let x = input[lower + k];
        let y = input[upper + k];
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
    if (mine >= layer.outputs) {
        return;
    }
    let to = (row + chunk.first * layer.whole) * layer.output_stride + column;
    store(to + 0u * layer.output_stride, a0);
    store(to + 1u * layer.output_stride, a1);
    store(to + 2u * layer.output_stride, a2);
    store(to + 3u * layer.output_stride, a3);
    store(to + 4u * layer.output_stride, a4);
    store(to + 5u * layer.output_stride, a5);
    store(to + 6u * layer.output_stride, a6);
    store(to + 7u * layer.output_stride, a7);
    store(to + 8u * layer.output_stride, a8);
    store(to + 9u * layer.output_stride, a9);
    store(to + 10u * layer.output_stride, a10);
    store(to + 11u * layer.output_stride, a11);
    store(to + 12u * layer.output_stride, a12);
    store(to + 13u * layer.output_stride, a13);
    store(to + 14u * layer.output_stride, a14);
    store(to + 15u * layer.output_stride, a15);
}
