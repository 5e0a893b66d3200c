// The gradients by the splats of a tile, reduced over subgroups of SUBGROUP lanes;
// see shared/raster_backward.wgsl.
// Dispatch: a workgroup a tile.
#import shared/grid.wgsl
#import shared/partial_subgroup.wgsl

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(subgroup_invocation_id) lane_in_subgroup: u32,
) {
    backward(flat_workgroup(workgroup, workgroups), lane, lane_in_subgroup);
}
