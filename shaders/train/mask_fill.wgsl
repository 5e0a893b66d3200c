// The prediction with masked pixels replaced by the target, where it then has no error.
// Reads prediction [3, H, W], truth [ceil(3 H W / 2)] (two 16-bit values a word), kept [ceil(H W /
// 32)] (a bit a pixel). Writes filled [3, H, W]. Dispatch: 3 H W invocations.
#import shared/grid.wgsl
#import shared/loss.wgsl
#import shared/mask.wgsl

const WIDTH: u32 = 64;

@group(0) @binding(0) var<uniform> size: LossUniform;
@group(0) @binding(1) var<storage, read> prediction: array<f32>;
@group(0) @binding(2) var<storage, read> truth: array<u32>;
@group(0) @binding(3) var<storage, read> kept: array<u32>;
@group(0) @binding(4) var<storage, read_write> filled: array<f32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    if index >= size.values {
        return;
    }
    let pixel = index % (size.width * size.height);
    let target_value = unpacked(truth[index / 2u], index);
    filled[index] = select(target_value, prediction[index], holds(kept[pixel / 32u], pixel));
}
