// The derivative by the input of one fully connected layer, for 8 pixels x 8 inputs an invocation.
// Reads delta [count, output_stride] (the derivative before the relu of the layer), parameters,
// input [count, input_stride]. Writes input_delta [count, input_stride]. Dispatch: ceil(count / 8)
// ceil(inputs / 2).
// input_delta = delta W^T, 0 where the input came out of a relu as 0.
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> layer: LayerUniform;
@group(0) @binding(1) var<uniform> chunk: ChunkUniform;
@group(0) @binding(2) var<storage, read> delta: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> parameters: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> input_delta: array<vec4<f32>>;

// The weights of four outputs and four inputs, a column an input.
fn weights(at: u32) -> mat4x4<f32> {
    let stride = layer.outputs;
    return mat4x4<f32>(
        parameters[at],
        parameters[at + stride],
        parameters[at + 2u * stride],
        parameters[at + 3u * stride],
    );
}

fn gated(value: vec4<f32>, at: u32) -> vec4<f32> {
    let passes = (input[at] > vec4<f32>(0.0)) | vec4<bool>(layer.input_relu == 0u);
    return select(vec4<f32>(0.0), value, passes);
}

fn store(at: u32, lower: vec4<f32>, upper: vec4<f32>, both: bool) {
    input_delta[at] = gated(lower, at);
    if both {
        input_delta[at + 1u] = gated(upper, at + 1u);
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    let across = (layer.inputs + 1u) / 2u;
    let column = (index % across) * 2u;
    let row = (index / across) * 8u;
    if row >= chunk.count {
        return;
    }
    let both = column + 1u < layer.inputs;
    let stride = layer.output_stride;
    let at = row * stride;
    let lower_weights = layer.weights + 4u * column * layer.outputs;
    let upper_weights = layer.weights + 4u * (column + u32(both)) * layer.outputs;
    var a0 = vec4<f32>(0.0);
    var b0 = vec4<f32>(0.0);
    var a1 = vec4<f32>(0.0);
    var b1 = vec4<f32>(0.0);
    var a2 = vec4<f32>(0.0);
    var b2 = vec4<f32>(0.0);
    var a3 = vec4<f32>(0.0);
    var b3 = vec4<f32>(0.0);
    var a4 = vec4<f32>(0.0);
    var b4 = vec4<f32>(0.0);
    var a5 = vec4<f32>(0.0);
    var b5 = vec4<f32>(0.0);
    var a6 = vec4<f32>(0.0);
    var b6 = vec4<f32>(0.0);
    var a7 = vec4<f32>(0.0);
    var b7 = vec4<f32>(0.0);
    for (var k = 0u; k < layer.outputs; k++) {
        let lower = weights(lower_weights + k);
        let upper = weights(upper_weights + k);
        let x0 = delta[at + 0u * stride + k];
        a0 += x0 * lower;
        b0 += x0 * upper;
        let x1 = delta[at + 1u * stride + k];
        a1 += x1 * lower;
        b1 += x1 * upper;
        let x2 = delta[at + 2u * stride + k];
        a2 += x2 * lower;
        b2 += x2 * upper;
        let x3 = delta[at + 3u * stride + k];
        a3 += x3 * lower;
        b3 += x3 * upper;
        let x4 = delta[at + 4u * stride + k];
        a4 += x4 * lower;
        b4 += x4 * upper;
        let x5 = delta[at + 5u * stride + k];
        a5 += x5 * lower;
        b5 += x5 * upper;
        let x6 = delta[at + 6u * stride + k];
        a6 += x6 * lower;
        b6 += x6 * upper;
        let x7 = delta[at + 7u * stride + k];
        a7 += x7 * lower;
        b7 += x7 * upper;
    }
    let to = row * layer.input_stride + column;
    store(to + 0u * layer.input_stride, a0, b0, both);
    store(to + 1u * layer.input_stride, a1, b1, both);
    store(to + 2u * layer.input_stride, a2, b2, both);
    store(to + 3u * layer.input_stride, a3, b3, both);
    store(to + 4u * layer.input_stride, a4, b4, both);
    store(to + 5u * layer.input_stride, a5, b5, both);
    store(to + 6u * layer.input_stride, a6, b6, both);
    store(to + 7u * layer.input_stride, a7, b7, both);
}
