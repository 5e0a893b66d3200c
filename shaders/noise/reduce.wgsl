// The sum of all cells' vectors, by one workgroup, always in the same order.
// Reads values [cells, 4]. Writes total [1]. Dispatch: one workgroup.
// total = sum values (WEIGHTED = 0) or sum values * values.w, the mean over the image (WEIGHTED =
// 1).
#import shared/noise.wgsl

const WIDTH: u32 = 64;
const WEIGHTED: u32 = 0;

@group(0) @binding(0) var<uniform> field: NoiseUniform;
@group(0) @binding(1) var<storage, read> values: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> total: array<vec4<f32>>;

var<workgroup> sums: array<vec4<f32>, WIDTH>;

@compute @workgroup_size(WIDTH)
fn main(@builtin(local_invocation_index) local: u32) {
    var sum = vec4<f32>(0.0);
    for (var i = local; i < field.columns * field.rows; i += WIDTH) {
        let value = values[i];
        sum += value * select(1.0, value.w, WEIGHTED == 1u);
    }
    sums[local] = sum;
    for (var half = WIDTH / 2u; half > 0u; half /= 2u) {
        // The sums of the round before must be written before they are read.
        workgroupBarrier();
        if local < half {
            sums[local] += sums[local + half];
        }
    }
    if local == 0u {
        total[0] = sums[0];
    }
}
