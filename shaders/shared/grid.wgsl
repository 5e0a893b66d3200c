// The flat index of a workgroup. A dispatch of more than 65,535 workgroups is folded into rows,
// because no dimension may be larger; the last row may be incomplete, so every kernel guards its
// indexes.

fn flat_workgroup(workgroup: vec3<u32>, workgroups: vec3<u32>) -> u32 {
    return workgroup.x + workgroup.y * workgroups.x;
}
