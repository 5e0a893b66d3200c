//! Real spherical harmonics to degree 3, in the order and with the signs of 3DGS.

const C0: f64 = 0.282_094_791_773_878_14;
const C1: f64 = 0.488_602_511_902_919_9;
const C2: [f64; 3] = [1.092_548_430_592_079_2, 0.315_391_565_252_520_05, 0.546_274_215_296_039_6];
const C3: [f64; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

/// Number of coefficients of `degree`: (degree + 1)^2.
pub fn coefficients(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

/// All 16 functions at the unit direction `d`.
pub fn basis(d: [f64; 3]) -> [f64; 16] {
    let [x, y, z] = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        -C2[0] * y * z,
        C2[1] * (2.0 * zz - xx - yy),
        -C2[0] * x * z,
        C2[2] * (xx - yy),
        -C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        -C3[2] * y * (4.0 * zz - xx - yy),
        C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -C3[2] * x * (4.0 * zz - xx - yy),
        C3[4] * z * (xx - yy),
        -C3[0] * x * (xx - 3.0 * yy),
    ]
}

/// Derivatives of the polynomials of [`basis`] with respect to x, y, z as free variables.
pub fn basis_gradient(d: [f64; 3]) -> [[f64; 3]; 16] {
    let [x, y, z] = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let [a, b, c] = C2;
    let [e, f, g, h, i] = C3;
    [
        [0.0; 3],
        [0.0, -C1, 0.0],
        [0.0, 0.0, C1],
        [-C1, 0.0, 0.0],
        [a * y, a * x, 0.0],
        [0.0, -a * z, -a * y],
        [-2.0 * b * x, -2.0 * b * y, 4.0 * b * z],
        [-a * z, 0.0, -a * x],
        [2.0 * c * x, -2.0 * c * y, 0.0],
        [-6.0 * e * x * y, -3.0 * e * (xx - yy), 0.0],
        [f * y * z, f * x * z, f * x * y],
        [2.0 * g * x * y, -g * (4.0 * zz - xx - 3.0 * yy), -8.0 * g * y * z],
        [-6.0 * h * x * z, -6.0 * h * y * z, h * (6.0 * zz - 3.0 * xx - 3.0 * yy)],
        [-g * (4.0 * zz - 3.0 * xx - yy), 2.0 * g * x * y, -8.0 * g * x * z],
        [2.0 * i * x * z, -2.0 * i * y * z, i * (xx - yy)],
        [-3.0 * e * (xx - yy), 6.0 * e * x * y, 0.0],
    ]
}
