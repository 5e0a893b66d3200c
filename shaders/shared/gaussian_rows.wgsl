// Layout of a Gaussian in `geometry` (three vectors a row) and `sh` (camera.sh_row vectors a row:
// red, green and blue of each coefficient in turn, padded with zeros). Needs `camera`, and both
// arrays.
#import shared/harmonics.wgsl
#import shared/projection.wgsl

fn load_geometry(row: u32) -> Geometry {
    let a = geometry[3u * row];
    let b = geometry[3u * row + 1u];
    let c = geometry[3u * row + 2u];
    return Geometry(a.xyz, vec3<f32>(a.w, b.xy), vec4<f32>(b.zw, c.xy), c.z);
}

// The vectors that hold the active bands, and zeros.
fn load_harmonics(row: u32) -> array<vec4<f32>, 12> {
    var v = array<vec4<f32>, 12>();
    let at = row * camera.sh_row;
    v[0] = sh[at];
    if (camera.sh_degree >= 1u) {
        v[1] = sh[at + 1u];
        v[2] = sh[at + 2u];
    }
    if (camera.sh_degree >= 2u) {
        v[3] = sh[at + 3u];
        v[4] = sh[at + 4u];
        v[5] = sh[at + 5u];
        v[6] = sh[at + 6u];
    }
    if (camera.sh_degree >= 3u) {
        v[7] = sh[at + 7u];
        v[8] = sh[at + 8u];
        v[9] = sh[at + 9u];
        v[10] = sh[at + 10u];
        v[11] = sh[at + 11u];
    }
    return v;
}

// The coefficients in three of its vectors.
fn coefficients(a: vec4<f32>, b: vec4<f32>, c: vec4<f32>) -> mat4x3<f32> {
    return mat4x3<f32>(a.xyz, vec3<f32>(a.w, b.xy), vec3<f32>(b.zw, c.x), c.yzw);
}

fn harmonics_colour(v: array<vec4<f32>, 12>, b: array<f32, 16>) -> vec3<f32> {
    return vec3<f32>(0.5)
        + coefficients(v[0], v[1], v[2]) * vec4<f32>(b[0], b[1], b[2], b[3])
        + coefficients(v[3], v[4], v[5]) * vec4<f32>(b[4], b[5], b[6], b[7])
        + coefficients(v[6], v[7], v[8]) * vec4<f32>(b[8], b[9], b[10], b[11])
        + coefficients(v[9], v[10], v[11]) * vec4<f32>(b[12], b[13], b[14], b[15]);
}
