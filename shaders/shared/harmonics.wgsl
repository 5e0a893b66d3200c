// Real spherical harmonics to degree 3, in the order and with the signs of 3DGS; the reference is
// src/core/splat/reference/harmonics.rs.

const SH0: f32 = 0.28209479;
const SH1: f32 = 0.48860251;
const SH2 = vec3<f32>(1.09254843, 0.31539157, 0.54627422);
const SH3 = array<f32, 5>(0.59004359, 2.89061144, 0.45704580, 0.37317633, 1.44530572);

// One or zero for the bands 1, 2 and 3.
fn sh_bands(degree: u32) -> vec3<f32> {
    return vec3<f32>(f32(degree >= 1u), f32(degree >= 2u), f32(degree >= 3u));
}

// The 16 functions at the unit direction d; zero above the degree.
fn sh_basis(d: vec3<f32>, degree: u32) -> array<f32, 16> {
    let bands = sh_bands(degree);
    let first = SH1 * bands.x;
    let a = SH2.x * bands.y;
    let b = SH2.y * bands.y;
    let c = SH2.z * bands.y;
    let e = SH3[0] * bands.z;
    let f = SH3[1] * bands.z;
    let g = SH3[2] * bands.z;
    let h = SH3[3] * bands.z;
    let i = SH3[4] * bands.z;
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let s = d * d;
    return array<f32, 16>(
        SH0,
        -first * y,
        first * z,
        -first * x,
        a * x * y,
        -a * y * z,
        b * (2.0 * s.z - s.x - s.y),
        -a * x * z,
        c * (s.x - s.y),
        -e * y * (3.0 * s.x - s.y),
        f * x * y * z,
        -g * y * (4.0 * s.z - s.x - s.y),
        h * z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y),
        -g * x * (4.0 * s.z - s.x - s.y),
        i * z * (s.x - s.y),
        -e * x * (s.x - 3.0 * s.y),
    );
}

// Derivatives of the polynomials by x, y, z as free variables; zero above the degree.
fn sh_slopes(d: vec3<f32>, degree: u32) -> array<vec3<f32>, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let s = d * d;
    let bands = sh_bands(degree);
    let first = SH1 * bands.x;
    let a = SH2.x * bands.y;
    let b = SH2.y * bands.y;
    let c = SH2.z * bands.y;
    let e = SH3[0] * bands.z;
    let f = SH3[1] * bands.z;
    let g = SH3[2] * bands.z;
    let h = SH3[3] * bands.z;
    let i = SH3[4] * bands.z;
    return array<vec3<f32>, 16>(
        vec3<f32>(0.0),
        vec3<f32>(0.0, -first, 0.0),
        vec3<f32>(0.0, 0.0, first),
        vec3<f32>(-first, 0.0, 0.0),
        vec3<f32>(a * y, a * x, 0.0),
        vec3<f32>(0.0, -a * z, -a * y),
        vec3<f32>(-2.0 * b * x, -2.0 * b * y, 4.0 * b * z),
        vec3<f32>(-a * z, 0.0, -a * x),
        vec3<f32>(2.0 * c * x, -2.0 * c * y, 0.0),
        vec3<f32>(-6.0 * e * x * y, -3.0 * e * (s.x - s.y), 0.0),
        vec3<f32>(f * y * z, f * x * z, f * x * y),
        vec3<f32>(2.0 * g * x * y, -g * (4.0 * s.z - s.x - 3.0 * s.y), -8.0 * g * y * z),
        vec3<f32>(-6.0 * h * x * z, -6.0 * h * y * z, h * (6.0 * s.z - 3.0 * s.x - 3.0 * s.y)),
        vec3<f32>(-g * (4.0 * s.z - 3.0 * s.x - s.y), 2.0 * g * x * y, -8.0 * g * x * z),
        vec3<f32>(2.0 * i * x * z, -2.0 * i * y * z, i * (s.x - s.y)),
        vec3<f32>(-3.0 * e * (s.x - s.y), 6.0 * e * x * y, 0.0),
    );
}
