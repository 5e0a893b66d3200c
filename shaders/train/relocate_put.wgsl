// Writes the Gaussian taken for a dead or new one, a move an invocation, if the target is in this
// part, and clears its moments. Log-scales and logit come from `shape`; the source's own change
// too.
// Reads moves [rows], shape [rows] (log-scale xyz, logit), taken [rows, 12 + sh_row]. Reads and
// writes geometry [part, 12], geometry_moments [part, 2, 12], sh [part, sh_row], sh_moments [part,
// 2, sh_row]. Dispatch: rows.
#import shared/grid.wgsl
#import shared/part.wgsl
#import shared/relocate.wgsl

const WIDTH: u32 = 64;

@group(0) @binding(0) var<uniform> relocation: RelocateUniform;
@group(0) @binding(1) var<uniform> part: PartUniform;
@group(0) @binding(2) var<storage, read> moves: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> shape: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> taken: array<f32>;
@group(0) @binding(5) var<storage, read_write> geometry: array<f32>;
@group(0) @binding(6) var<storage, read_write> geometry_moments: array<f32>;
@group(0) @binding(7) var<storage, read_write> sh: array<f32>;
@group(0) @binding(8) var<storage, read_write> sh_moments: array<f32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    if (row >= relocation.rows) {
        return;
    }
    let to = moves[row].x - part.first;
    // Below the part's first it wraps around, far above its rows.
    if (to >= part.rows) {
        return;
    }
    if (moves[row].x != moves[row].y) {
        let at = row * (12u + relocation.sh_row);
        for (var n = 0u; n < 10u; n++) {
            geometry[to * 12u + n] = taken[at + n];
        }
        for (var n = 0u; n < relocation.sh_row; n++) {
            sh[to * relocation.sh_row + n] = taken[at + 12u + n];
        }
    }
    for (var axis = 0u; axis < 3u; axis++) {
        geometry[to * 12u + 3u + axis] = shape[row][axis];
    }
    geometry[to * 12u + 10u] = shape[row].w;
    for (var n = 0u; n < 24u; n++) {
        geometry_moments[to * 24u + n] = 0.0;
    }
    for (var n = 0u; n < 2u * relocation.sh_row; n++) {
        sh_moments[to * 2u * relocation.sh_row + n] = 0.0;
    }
}
