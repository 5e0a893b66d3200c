// Zeroes the gradient in masked pixels, whose prediction has no part in the loss.
// Reads kept [ceil(H W / 32)] (a bit a pixel). Updates (reads and writes) gradient [3, H, W].
// Dispatch: 3 H W invocations.
#import shared/grid.wgsl
#import shared/loss.wgsl
#import shared/mask.wgsl

const WIDTH: u32 = 64;

@group(0) @binding(0) var<uniform> size: LossUniform;
@group(0) @binding(1) var<storage, read> kept: array<u32>;
@group(0) @binding(2) var<storage, read_write> gradient: array<f32>;

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
    if !holds(kept[pixel / 32u], pixel) {
        gradient[index] = 0.0;
    }
}
