// The derivative of loss and penalty by the centred noise of one cell an invocation: the transpose
// of the bilinear upsampling.
// Reads values [cells, 4], mean [1], gradient [3, H, W]. Writes cell_gradient [cells, 4]. Dispatch:
// cells.
// g = sum over the pixels of weight * dL/dprediction + penalty * (n - mean(n)).
#import shared/grid.wgsl
#import shared/noise.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> field: NoiseUniform;
@group(0) @binding(1) var<storage, read> values: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> mean: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> gradient: array<f32>;
@group(0) @binding(4) var<storage, read_write> cell_gradient: array<vec4<f32>>;

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
    let pixels = field.width * field.height;
    let column = index % field.columns;
    let row = index / field.columns;
    let horizontal = support(column, field.scale, field.width);
    let vertical = support(row, field.scale, field.height);
    var sum = vec3<f32>(0.0);
    for (var y = vertical.x; y < vertical.y; y++) {
        var line = vec3<f32>(0.0);
        for (var x = horizontal.x; x < horizontal.y; x++) {
            let at = y * field.width + x;
            let g = vec3<f32>(gradient[at], gradient[at + pixels], gradient[at + 2u * pixels]);
            line += tent(x, column, field.scale, field.columns) * g;
        }
        sum += tent(y, row, field.scale, field.rows) * line;
    }
    let n = values[index].xyz - mean[0].xyz;
    cell_gradient[index] = vec4<f32>(sum + field.penalty * n, 0.0);
}
