// Copies the source Gaussian of a move, a move an invocation, if the source is in this part.
// Reads moves [rows], geometry [part, 12], sh [part, sh_row]. Writes taken [rows, 12 + sh_row].
// Dispatch: rows.
#import shared/grid.wgsl
#import shared/part.wgsl
#import shared/relocate.wgsl

const WIDTH: u32 = 64;

@group(0) @binding(0) var<uniform> relocation: RelocateUniform;
@group(0) @binding(1) var<uniform> part: PartUniform;
@group(0) @binding(2) var<storage, read> moves: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> geometry: array<f32>;
@group(0) @binding(4) var<storage, read> sh: array<f32>;
@group(0) @binding(5) var<storage, read_write> taken: array<f32>;

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
    let origin = moves[row].y - part.first;
    // Below the part's first it wraps around, far above its rows.
    if (moves[row].x == moves[row].y || origin >= part.rows) {
        return;
    }
    let at = row * (12u + relocation.sh_row);
    for (var n = 0u; n < 12u; n++) {
        taken[at + n] = geometry[origin * 12u + n];
    }
    for (var n = 0u; n < relocation.sh_row; n++) {
        taken[at + 12u + n] = sh[origin * relocation.sh_row + n];
    }
}
