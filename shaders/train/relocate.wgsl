// Copies one Gaussian an invocation onto a dead or new one (MCMC densification). Each row of
// `moves` is (target, source) with the logit and log-scales both end up with; a row whose target is its source
// only changes those. Moments of the target are cleared. No source is a target of another row.
// Reads moves [rows, 2], shape [rows] (log-scale xyz, logit). Reads and writes geometry, sh and their
// moments. Dispatch: rows.
#import shared/grid.wgsl

const WIDTH: u32 = 64;

struct RelocateUniform {
    rows: u32,
    // Floats of the harmonics of a Gaussian.
    sh_row: u32,
    pad_0: u32,
    pad_1: u32,
}

@group(0) @binding(0) var<uniform> relocation: RelocateUniform;
@group(0) @binding(1) var<storage, read> moves: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> shape: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> geometry: array<f32>;
@group(0) @binding(4) var<storage, read_write> geometry_moments: array<f32>;
@group(0) @binding(5) var<storage, read_write> sh: array<f32>;
@group(0) @binding(6) var<storage, read_write> sh_moments: array<f32>;

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
    let to = moves[row].x;
    let origin = moves[row].y;
    if (to != origin) {
        for (var n = 0u; n < 12u; n++) {
            // Log-scales and logit come from `shape`: the source's own are being changed.
            if (n < 3u || (n >= 6u && n < 10u)) {
                geometry[to * 12u + n] = geometry[origin * 12u + n];
            }
        }
        for (var n = 0u; n < relocation.sh_row; n++) {
            sh[to * relocation.sh_row + n] = sh[origin * relocation.sh_row + n];
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
