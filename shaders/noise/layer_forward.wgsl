// One fully connected layer for 8 pixels x 8 outputs an invocation.
// Reads input [count, input_stride], parameters. Writes output [count, output_stride]. Rows past
// count, up to a multiple of 8, are written with nothing of meaning. Dispatch: ceil(count / 8)
// ceil(outputs / 2).
// output = relu(input W + b), or without the relu.
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

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

fn store(at: u32, lower: vec4<f32>, upper: vec4<f32>, both: bool) {
    let least = select(-3.4e38, 0.0, layer.relu == 1u);
    output[at] = max(lower, vec4<f32>(least));
    if both {
        output[at + 1u] = max(upper, vec4<f32>(least));
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    let across = (layer.outputs + 1u) / 2u;
    let column = (index % across) * 2u;
    let row = (index / across) * 8u;
    if row >= chunk.count {
        return;
    }
    let both = column + 1u < layer.outputs;
    let stride = layer.input_stride;
    let at = row * stride;
    let bias = parameters[layer.biases + column];
    let upper_bias = parameters[layer.biases + min(column + 1u, layer.outputs - 1u)];
    var a0 = bias;
    var b0 = upper_bias;
    var a1 = bias;
    var b1 = upper_bias;
    var a2 = bias;
    var b2 = upper_bias;
    var a3 = bias;
    var b3 = upper_bias;
    var a4 = bias;
    var b4 = upper_bias;
    var a5 = bias;
    var b5 = upper_bias;
    var a6 = bias;
    var b6 = upper_bias;
    var a7 = bias;
    var b7 = upper_bias;
    for (var k = 0u; k < layer.inputs; k++) {
        let first = layer.weights + 4u * k * layer.outputs + column;
        let lower = weights(first);
        let upper = weights(first + u32(both));
        let x0 = input[at + 0u * stride + k];
        a0 += lower * x0;
        b0 += upper * x0;
        let x1 = input[at + 1u * stride + k];
        a1 += lower * x1;
        b1 += upper * x1;
        let x2 = input[at + 2u * stride + k];
        a2 += lower * x2;
        b2 += upper * x2;
        let x3 = input[at + 3u * stride + k];
        a3 += lower * x3;
        b3 += upper * x3;
        let x4 = input[at + 4u * stride + k];
        a4 += lower * x4;
        b4 += upper * x4;
        let x5 = input[at + 5u * stride + k];
        a5 += lower * x5;
        b5 += upper * x5;
        let x6 = input[at + 6u * stride + k];
        a6 += lower * x6;
        b6 += upper * x6;
        let x7 = input[at + 7u * stride + k];
        a7 += lower * x7;
        b7 += upper * x7;
    }
    let to = (row + chunk.first * layer.whole) * layer.output_stride + column;
    store(to + 0u * layer.output_stride, a0, b0, both);
    store(to + 1u * layer.output_stride, a1, b1, both);
    store(to + 2u * layer.output_stride, a2, b2, both);
    store(to + 3u * layer.output_stride, a3, b3, both);
    store(to + 4u * layer.output_stride, a4, b4, both);
    store(to + 5u * layer.output_stride, a5, b5, both);
    store(to + 6u * layer.output_stride, a6, b6, both);
    store(to + 7u * layer.output_stride, a7, b7, both);
}
