// The derivatives of 8 x 8 weights of one layer over one segment of the chunk's pixels an
// invocation, and of 8 biases where its inputs are the first.
// Reads delta [count, output_stride], input [count, input_stride]. Writes gradients [segments,
// parameters]; chunks after the first add to them. Dispatch: segments ceil(inputs / 2) ceil(outputs
// / 2).
// dW = input^T delta, db = sum delta.
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> layer: LayerUniform;
@group(0) @binding(1) var<uniform> chunk: ChunkUniform;
@group(0) @binding(2) var<storage, read> delta: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> gradients: array<vec4<f32>>;

fn add(at: u32, value: vec4<f32>) {
    if chunk.first == 0u {
        gradients[at] = value;
    } else {
        gradients[at] += value;
    }
}

fn store(at: u32, lower: vec4<f32>, upper: vec4<f32>, both: bool) {
    add(at, lower);
    if both {
        add(at + 1u, upper);
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
    let down = (layer.inputs + 1u) / 2u;
    let column = (index % across) * 2u;
    let row = (index / across) % down * 2u;
    let segment = index / (across * down);
    if segment >= layer.segments {
        return;
    }
    let both_columns = column + 1u < layer.outputs;
    let both_rows = row + 1u < layer.inputs;
    let length = (chunk.count + layer.segments - 1u) / layer.segments;
    let end = min((segment + 1u) * length, chunk.count);
    var bias = vec4<f32>(0.0);
    var upper_bias = vec4<f32>(0.0);
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
    for (var cell = segment * length; cell < end; cell++) {
        let lower = delta[cell * layer.output_stride + column];
        let upper = delta[cell * layer.output_stride + column + u32(both_columns)];
        let x = input[cell * layer.input_stride + row];
        let y = input[cell * layer.input_stride + row + u32(both_rows)];
        bias += lower;
        upper_bias += upper;
        a0 += x.x * lower;
        b0 += x.x * upper;
        a1 += x.y * lower;
        b1 += x.y * upper;
        a2 += x.z * lower;
        b2 += x.z * upper;
        a3 += x.w * lower;
        b3 += x.w * upper;
        a4 += y.x * lower;
        b4 += y.x * upper;
        a5 += y.y * lower;
        b5 += y.y * upper;
        a6 += y.z * lower;
        b6 += y.z * upper;
        a7 += y.w * lower;
        b7 += y.w * upper;
    }
    let base = segment * layer.parameters;
    let at = base + layer.weights + 4u * row * layer.outputs + column;
    store(at, a0, b0, both_columns);
    store(at + 1u * layer.outputs, a1, b1, both_columns);
    store(at + 2u * layer.outputs, a2, b2, both_columns);
    store(at + 3u * layer.outputs, a3, b3, both_columns);
    if both_rows {
        store(at + 4u * layer.outputs, a4, b4, both_columns);
        store(at + 5u * layer.outputs, a5, b5, both_columns);
        store(at + 6u * layer.outputs, a6, b6, both_columns);
        store(at + 7u * layer.outputs, a7, b7, both_columns);
    }
    if row == 0u {
        store(base + layer.biases + column, bias, upper_bias, both_columns);
    }
}
