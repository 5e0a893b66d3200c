// The noise of one cell an invocation, before its mean is removed, and the cell's share of the
// image.
// Reads raw [cells, 4]. Writes values [cells, 4] = (n_r, n_g, n_b, share). Dispatch: cells.
// n = A tanh(raw) or A sigmoid(raw); share = sum over the pixels of the bilinear weight / (W H).
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> field: NoiseUniform;
@group(0) @binding(1) var<storage, read> raw: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> values: array<vec4<f32>>;

fn axis_share(cell: u32, cells: u32, pixels: u32) -> f32 {
    let range = support(cell, field.scale, pixels);
    var sum = 0.0;
    for (var pixel = range.x; pixel < range.y; pixel++) {
        sum += tent(pixel, cell, field.scale, cells);
    }
    return sum / f32(pixels);
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    if index >= field.columns * field.rows {
        return;
    }
    let x = raw[index].xyz;
    var n = field.amplitude / (1.0 + exp(-x));
    if field.centred == 1u {
        // tanh overflows to NaN for large arguments in some drivers.
        n = field.amplitude * tanh(clamp(x, vec3<f32>(-15.0), vec3<f32>(15.0)));
    }
    let share = axis_share(index % field.columns, field.columns, field.width)
        * axis_share(index / field.columns, field.rows, field.height);
    values[index] = vec4<f32>(n, share);
}
