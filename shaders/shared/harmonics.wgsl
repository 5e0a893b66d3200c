// Real spherical harmonics to degree 3, in the order and with the signs of 3DGS; the meaning
// is src/core/splat/reference/harmonics.rs.

const SH0: f32 = 0.28209479;
const SH1: f32 = 0.48860251;
const SH2 = vec3<f32>(1.09254843, 0.31539157, 0.54627422);
const SH3 = array<f32, 5>(0.59004359, 2.89061144, 0.45704580, 0.37317633, 1.44530572);

// Coefficients of a degree.
fn sh_count(degree: u32) -> u32 {
    return (degree + 1u) * (degree + 1u);
}

// The 16 functions at the unit direction d.
fn sh_basis(d: vec3<f32>) -> array<f32, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let s = d * d;
    return array<f32, 16>(
        SH0,
        -SH1 * y,
        SH1 * z,
        -SH1 * x,
        SH2.x * x * y,
        -SH2.x * y * z,
        SH2.y * (2.0 * s.z - s.x - s.y),
        -SH2.x * x * z,
        SH2.z * (s.x - s.y),
        -SH3[0] * y * (3.0 * s.x - s.y),
        SH3[1] * x * y * z,
        -SH3[2] * y * (4.0 * s.z - s.x - s.y),
        SH3[3] * z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y),
        -SH3[2] * x * (4.0 * s.z - s.x - s.y),
        SH3[4] * z * (s.x - s.y),
        -SH3[0] * x * (s.x - 3.0 * s.y),
    );
}

// Derivatives of the polynomials by x, y, z as free variables.
fn sh_slopes(d: vec3<f32>) -> array<vec3<f32>, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let s = d * d;
    let a = SH2.x;
    let b = SH2.y;
    let c = SH2.z;
    let e = SH3[0];
    let f = SH3[1];
    let g = SH3[2];
    let h = SH3[3];
    let i = SH3[4];
    return array<vec3<f32>, 16>(
        vec3<f32>(0.0),
        vec3<f32>(0.0, -SH1, 0.0),
        vec3<f32>(0.0, 0.0, SH1),
        vec3<f32>(-SH1, 0.0, 0.0),
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
