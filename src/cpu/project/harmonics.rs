//! Real spherical harmonics to degree 3, in the order and with the signs of 3DGS; the reference is
//! the core's src/core/splat/reference/harmonics.rs.

use fearless_simd::prelude::*;

use crate::simd::{F, Lanes, load, splat};
use crate::vector::V3;

const C0: f32 = 0.282_094_8;
const C1: f32 = 0.488_602_52;
const C2: [f32; 3] = [1.092_548_5, 0.315_391_57, 0.546_274_24];
const C3: [f32; 5] = [0.590_043_6, 2.890_611_4, 0.457_045_8, 0.373_176_34, 1.445_305_7];

/// Coefficients of a degree.
pub(crate) fn coefficients(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

/// The functions at the unit direction up to the degree, which fill the first of the 16.
#[inline(always)]
pub(crate) fn basis<S: Simd>(simd: S, [x, y, z]: V3<S>, degree: u32) -> [F<S>; 16] {
    let mut out = [splat(simd, 0.0); 16];
    out[0] = splat(simd, C0);
    if degree == 0 {
        return out;
    }
    out[1] = y * -C1;
    out[2] = z * C1;
    out[3] = x * -C1;
    if degree == 1 {
        return out;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, yz, xz) = (x * y, y * z, x * z);
    out[4] = xy * C2[0];
    out[5] = yz * -C2[0];
    out[6] = (zz * 2.0 - xx - yy) * C2[1];
    out[7] = xz * -C2[0];
    out[8] = (xx - yy) * C2[2];
    if degree == 2 {
        return out;
    }
    out[9] = y * (xx * 3.0 - yy) * -C3[0];
    out[10] = xy * z * C3[1];
    out[11] = y * (zz * 4.0 - xx - yy) * -C3[2];
    out[12] = z * (zz * 2.0 - (xx + yy) * 3.0) * C3[3];
    out[13] = x * (zz * 4.0 - xx - yy) * -C3[2];
    out[14] = z * (xx - yy) * C3[4];
    out[15] = x * (xx - yy * 3.0) * -C3[0];
    out
}

/// The sum of weighted slopes of the functions by x, y, z as free variables.
#[inline(always)]
pub(crate) fn slope<S: Simd>(simd: S, [x, y, z]: V3<S>, degree: u32, w: &[F<S>; 16]) -> V3<S> {
    let zero = splat(simd, 0.0);
    if degree == 0 {
        return [zero; 3];
    }
    let mut sum = [w[3] * -C1, w[1] * -C1, w[2] * C1];
    if degree >= 2 {
        let (a, b, c) = (C2[0], C2[1], C2[2]);
        sum[0] += (w[4] * y - w[7] * z) * a + (w[8] * c - w[6] * b) * x * 2.0;
        sum[1] += (w[4] * x - w[5] * z) * a - (w[8] * c + w[6] * b) * y * 2.0;
        sum[2] += w[6] * z * (4.0 * b) - (w[5] * y + w[7] * x) * a;
    }
    if degree >= 3 {
        let [e, f, g, h, i] = C3;
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (xy, yz, xz) = (x * y, y * z, x * z);
        let difference = (xx - yy) * 3.0;
        sum[0] += w[9] * xy * (-6.0 * e) + w[10] * yz * f + w[11] * xy * (2.0 * g);
        sum[0] += w[12] * xz * (-6.0 * h) - w[13] * (zz * 4.0 - xx * 3.0 - yy) * g;
        sum[0] += w[14] * xz * (2.0 * i) - w[15] * difference * e;
        sum[1] += w[9] * difference * -e + w[10] * xz * f - w[11] * (zz * 4.0 - xx - yy * 3.0) * g;
        sum[1] += w[12] * yz * (-6.0 * h) + w[13] * xy * (2.0 * g);
        sum[1] += w[14] * yz * (-2.0 * i) + w[15] * xy * (6.0 * e);
        sum[2] += w[10] * xy * f - (w[11] * yz + w[13] * xz) * (8.0 * g);
        sum[2] += w[12] * (zz * 6.0 - (xx + yy) * 3.0) * h + w[14] * (xx - yy) * i;
    }
    sum
}

/// 0.5 and the weighted sum of the active coefficients, before the clamp at 0.
#[inline(always)]
pub(crate) fn colour<S: Simd>(
    simd: S,
    harmonics: &[Lanes],
    basis: &[F<S>; 16],
    degree: u32,
) -> V3<S> {
    let mut sum = [splat(simd, 0.5); 3];
    let (rows, _) = harmonics.as_chunks::<3>();
    for (row, value) in rows.iter().zip(basis).take(coefficients(degree)) {
        for (sum, lanes) in sum.iter_mut().zip(row) {
            *sum = load(simd, lanes).mul_add(*value, *sum);
        }
    }
    sum
}
