//! Terms shared by the projection's forward and backward pass, for sixteen Gaussians. The
//! reference is the core's src/core/splat/reference/projection.rs.

use fearless_simd::prelude::*;

use crate::View;
use crate::population::column;
use crate::simd::{F, Lanes, M, each, exp, is_finite, load, sigmoid, splat};
use crate::vector::{V3, blend, dot, scaled, symmetric};

/// Added to the diagonal of every 2-D covariance, px^2.
const LOW_PASS: f32 = 0.3;
/// Least determinant of a covariance, px^4.
const DETERMINANT_GUARD: f32 = 1e-6;
/// Limit of the Jacobian's position beyond the image, as a share of its size.
const FOV_MARGIN: f32 = 0.15;
/// Squared norm below which a quaternion has no direction.
const QUAT_GUARD: f32 = 1e-8;
/// Range of the exponentiated log-scale.
pub(crate) const LOG_SCALE_RANGE: [f32; 2] = [-30.0, 20.0];

/// Terms that do not depend on the camera.
pub(crate) struct Shape<S: Simd> {
    pub(crate) mean: V3<S>,
    pub(crate) unit_quat: [F<S>; 4],
    pub(crate) quat_norm: F<S>,
    pub(crate) scale: V3<S>,
    /// Columns.
    pub(crate) rotation: [V3<S>; 3],
    /// xx, xy, xz, yy, yz, zz.
    pub(crate) covariance: [F<S>; 6],
    pub(crate) opacity: F<S>,
    /// Finite, with a direction.
    pub(crate) usable: M<S>,
}

/// On the image plane.
pub(crate) struct Flat<S: Simd> {
    pub(crate) point: V3<S>,
    pub(crate) inverse_depth: F<S>,
    pub(crate) slope: [F<S>; 2],
    /// Whether the slope moves with the point: not clamped.
    pub(crate) moves: [M<S>; 2],
    /// First two rows of J W.
    pub(crate) linear: [V3<S>; 2],
    /// Covariance times each of them.
    pub(crate) spread: [V3<S>; 2],
    /// 2-D covariance a, b, c with the low-pass.
    pub(crate) flat: V3<S>,
    /// Its inverse.
    pub(crate) conic: V3<S>,
    pub(crate) usable: M<S>,
}

/// The rows of the rotation from world to camera.
#[inline(always)]
pub(crate) fn world<S: Simd>(simd: S, view: &View) -> [V3<S>; 3] {
    each!([0, 1, 2] row => each!([0, 1, 2] n => splat(simd, view.rows[row][n])))
}

/// 2 (a b + c d).
#[inline(always)]
fn double<S: Simd>(a: F<S>, b: F<S>, c: F<S>, d: F<S>) -> F<S> {
    a.mul_add(b, c * d) * 2.0
}

/// 1 - 2 (a^2 + b^2).
#[inline(always)]
fn diagonal<S: Simd>(a: F<S>, b: F<S>) -> F<S> {
    -(a.mul_add(a, b * b) * 2.0) + 1.0
}

#[inline(always)]
fn rotation<S: Simd>([w, x, y, z]: [F<S>; 4]) -> [V3<S>; 3] {
    [
        [diagonal(y, z), double(x, y, w, z), double(x, z, -w, y)],
        [double(x, y, -w, z), diagonal(x, z), double(y, z, w, x)],
        [double(x, z, w, y), double(y, z, -w, x), diagonal(x, y)],
    ]
}

/// R S^2 R^T.
#[inline(always)]
fn covariance<S: Simd>(rotation: &[V3<S>; 3], scale: V3<S>) -> [F<S>; 6] {
    let axes = each!([0, 1, 2] n => scaled(rotation[n], scale[n]));
    each!([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)] at => {
        let (i, j) = at;
        axes[2][i].mul_add(axes[2][j], axes[1][i].mul_add(axes[1][j], axes[0][i] * axes[0][j]))
    })
}

impl<S: Simd> Shape<S> {
    #[inline(always)]
    pub(crate) fn new(simd: S, numbers: &[Lanes]) -> Self {
        let mean = each!([0, 1, 2] n => load(simd, &numbers[column::MEAN + n]));
        let log_scale = each!([0, 1, 2] n => load(simd, &numbers[column::LOG_SCALE + n]));
        let quat = each!([0, 1, 2, 3] n => load(simd, &numbers[column::QUAT + n]));
        let logit = load(simd, &numbers[column::LOGIT]);
        let [w, x, y, z] = quat;
        let norm2 = w.mul_add(w, x.mul_add(x, y.mul_add(y, z * z)));
        let mut usable = norm2.simd_ge(QUAT_GUARD) & is_finite(norm2) & is_finite(logit);
        for n in 0..3 {
            usable = usable & is_finite(mean[n]) & is_finite(log_scale[n]);
        }
        let quat_norm = norm2.sqrt();
        let unit_quat = each!([w, x, y, z] v => v / quat_norm);
        let [low, high] = LOG_SCALE_RANGE;
        let scale = each!([0, 1, 2] n => exp(log_scale[n].max(low).min(high)));
        let rotation = rotation(unit_quat);
        let covariance = covariance(&rotation, scale);
        let opacity = sigmoid(logit);
        Self { mean, unit_quat, quat_norm, scale, rotation, covariance, opacity, usable }
    }
}

impl<S: Simd> Flat<S> {
    #[inline(always)]
    pub(crate) fn new(simd: S, shape: &Shape<S>, view: &View) -> Self {
        let world = world(simd, view);
        let point = each!([0, 1, 2] n => dot(world[n], shape.mean) + view.rows[n][3]);
        let inverse_depth = splat(simd, 1.0) / point[2];
        let [x, y] = each!([0, 1] n => {
            let (focal, centre, size) = (view.focal[n], view.centre[n], view.size[n] as f32);
            let margin = FOV_MARGIN * size / focal;
            let slope = point[n] * inverse_depth;
            let (low, high) = (-centre / focal - margin, (size - centre) / focal + margin);
            let held = slope.max(low).min(high);
            let linear = blend(
                world[n],
                inverse_depth * focal,
                world[2],
                -(held * inverse_depth) * focal,
            );
            (held, held.simd_eq(slope), linear)
        });
        let spread = [symmetric(&shape.covariance, x.2), symmetric(&shape.covariance, y.2)];
        let flat =
            [dot(x.2, spread[0]) + LOW_PASS, dot(x.2, spread[1]), dot(y.2, spread[1]) + LOW_PASS];
        let [a, b, c] = flat;
        let determinant = a.mul_add(c, -(b * b));
        let usable = shape.usable
            & point[2].simd_ge(view.near)
            & determinant.simd_gt(DETERMINANT_GUARD)
            & is_finite(determinant);
        let inverse = splat(simd, 1.0) / determinant;
        Self {
            point,
            inverse_depth,
            slope: [x.0, y.0],
            moves: [x.1, y.1],
            linear: [x.2, y.2],
            spread,
            flat,
            conic: [c * inverse, -b * inverse, a * inverse],
            usable,
        }
    }
}
