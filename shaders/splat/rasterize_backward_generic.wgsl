// The gradients by the splats of a tile on a device without subgroups;
// see shared/raster_backward.wgsl.
// Dispatch: a workgroup a tile.
#import shared/grid.wgsl
#import shared/partial_workgroup.wgsl

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    backward(flat_workgroup(workgroup, workgroups), lane, 0u);
}
