// The derivatives of the weights of one layer over all of the chunk's pixels, for 16 inputs a
// subgroup and 4 outputs a lane, and of the biases where its inputs are the first: a lane loads one
// pixel's inputs, and all lanes get them from it.
// Reads delta [count, output_stride], input [count, input_stride]. Writes gradients [parameters];
// chunks after the first add to them. Dispatch: a workgroup for 16 inputs and 32 outputs.
// dW = input^T delta, db = sum delta.
#import shared/grid.wgsl
#import shared/noise.wgsl

// Lanes of a subgroup.
const SUBGROUP: u32 = 8;

@group(0) @binding(0) var<uniform> layer: LayerUniform;
@group(0) @binding(1) var<uniform> chunk: ChunkUniform;
@group(0) @binding(2) var<storage, read> delta: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> gradients: array<vec4<f32>>;

fn add(at: u32, value: vec4<f32>) {
    if (chunk.first == 0u) {
        gradients[at] = value;
    } else {
        gradients[at] += value;
    }
}

fn add_block(at: u32, block: mat4x4<f32>) {
    for (var i = 0u; i < 4u; i++) {
        add(at + i * layer.outputs, block[i]);
    }
}

// The derivative of a pixel; pixels past the last have none.
fn delta_of(pixel: u32, column: u32) -> vec4<f32> {
    let d = delta[min(pixel, chunk.count - 1u) * layer.output_stride + column];
    return select(vec4<f32>(0.0), d, pixel < chunk.count);
}

// How four inputs meet four outputs.
fn outer(d: vec4<f32>, x: vec4<f32>) -> mat4x4<f32> {
    return mat4x4<f32>(x.x * d, x.y * d, x.z * d, x.w * d);
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
    let row = (index / across) * 4u;
    if (row >= layer.inputs) {
        return;
    }
    // Lanes past the last output compute it too, and do not store it; inputs past the last
    // likewise.
    let column = min(mine, layer.outputs - 1u);
    let last = layer.inputs - 1u;
    var bias = vec4<f32>(0.0);
    // Four inputs each, a column an input.
    var a = mat4x4<f32>();
    var b = mat4x4<f32>();
    var c = mat4x4<f32>();
    var d = mat4x4<f32>();
    for (var first = 0u; first < chunk.count; first += SUBGROUP) {
        let at = min(first + lane, chunk.count - 1u) * layer.input_stride;
        let p = input[at + row];
        let q = input[at + min(row + 1u, last)];
        let r = input[at + min(row + 2u, last)];
        let s = input[at + min(row + 3u, last)];
        let d0 = delta_of(first + 0u, column);
        bias += d0;
        a += outer(d0, subgroupBroadcast(p, 0u));
        b += outer(d0, subgroupBroadcast(q, 0u));
        c += outer(d0, subgroupBroadcast(r, 0u));
        d += outer(d0, subgroupBroadcast(s, 0u));
        let d1 = delta_of(first + 1u, column);
        bias += d1;
        a += outer(d1, subgroupBroadcast(p, 1u));
        b += outer(d1, subgroupBroadcast(q, 1u));
        c += outer(d1, subgroupBroadcast(r, 1u));
        d += outer(d1, subgroupBroadcast(s, 1u));
        let d2 = delta_of(first + 2u, column);
        bias += d2;
        a += outer(d2, subgroupBroadcast(p, 2u));
        b += outer(d2, subgroupBroadcast(q, 2u));
        c += outer(d2, subgroupBroadcast(r, 2u));
        d += outer(d2, subgroupBroadcast(s, 2u));
        let d3 = delta_of(first + 3u, column);
        bias += d3;
        a += outer(d3, subgroupBroadcast(p, 3u));
        b += outer(d3, subgroupBroadcast(q, 3u));
        c += outer(d3, subgroupBroadcast(r, 3u));
        d += outer(d3, subgroupBroadcast(s, 3u));
        let d4 = delta_of(first + 4u, column);
        bias += d4;
        a += outer(d4, subgroupBroadcast(p, 4u));
        b += outer(d4, subgroupBroadcast(q, 4u));
        c += outer(d4, subgroupBroadcast(r, 4u));
        d += outer(d4, subgroupBroadcast(s, 4u));
        let d5 = delta_of(first + 5u, column);
        bias += d5;
        a += outer(d5, subgroupBroadcast(p, 5u));
        b += outer(d5, subgroupBroadcast(q, 5u));
        c += outer(d5, subgroupBroadcast(r, 5u));
        d += outer(d5, subgroupBroadcast(s, 5u));
        let d6 = delta_of(first + 6u, column);
        bias += d6;
        a += outer(d6, subgroupBroadcast(p, 6u));
        b += outer(d6, subgroupBroadcast(q, 6u));
        c += outer(d6, subgroupBroadcast(r, 6u));
        d += outer(d6, subgroupBroadcast(s, 6u));
        let d7 = delta_of(first + 7u, column);
        bias += d7;
        a += outer(d7, subgroupBroadcast(p, 7u));
        b += outer(d7, subgroupBroadcast(q, 7u));
        c += outer(d7, subgroupBroadcast(r, 7u));
        d += outer(d7, subgroupBroadcast(s, 7u));
    }
    if (mine >= layer.outputs) {
        return;
    }
    let at = layer.weights + 4u * row * layer.outputs + column;
    add_block(at, a);
    if (row + 1u <= last) {
        add_block(at + 4u * layer.outputs, b);
    }
    if (row + 2u <= last) {
        add_block(at + 8u * layer.outputs, c);
    }
    if (row + 3u <= last) {
        add_block(at + 12u * layer.outputs, d);
    }
    if (row == 0u) {
        add(layer.biases + column, bias);
    }
}
