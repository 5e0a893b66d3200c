//! The backward pass of the projection.

use fearless_simd::prelude::*;

use super::Seen;
use crate::View;
use crate::population::column;
use crate::project::direction;
use crate::project::geometry::{Flat, LOG_SCALE_RANGE, Shape, world};
use crate::project::harmonics::{basis, coefficients, colour, slope};
use crate::simd::{F, Lanes, M, each, fits, load, splat};
use crate::vector::{V3, blend, dot, scaled};

/// The gradients of sixteen Gaussians.
pub(super) struct Gradient<S: Simd> {
    pub(super) shape: Shape<S>,
    pub(super) flat: Flat<S>,
    /// Mean, log-scale, quaternion, logit.
    pub(super) geometry: [F<S>; column::HARMONICS],
    /// By the colour, behind its clamp at 0.
    pub(super) colour: V3<S>,
    pub(super) basis: [F<S>; 16],
    /// By the mean on the image, px.
    pub(super) by_place: [F<S>; 2],
    /// Whether the Gaussian touches a tile.
    pub(super) touched: M<S>,
    /// Whether all gradients are finite.
    pub(super) fits: M<S>,
}

impl<S: Simd> Gradient<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, numbers: &[Lanes], seen: &Seen, view: &View) -> Self {
        let shape = Shape::new(simd, numbers);
        let flat = Flat::new(simd, &shape, view);
        let touched = load(simd, &seen.touched).simd_gt(0.0) & flat.usable;
        let (towards, distance) = direction(shape.mean, view);
        let basis = basis(simd, towards, view.sh_degree);
        let zero = splat(simd, 0.0);
        let harmonics = &numbers[column::HARMONICS..];
        let unclamped = colour(simd, harmonics, &basis, view.sh_degree);
        let by_colour = each!([0, 1, 2] n => {
            let gate = touched & unclamped[n].simd_gt(0.0);
            gate.select(seen.sum(simd, n), zero)
        });
        let along = weights(simd, harmonics, by_colour, view.sh_degree);
        let by_direction = slope(simd, towards, view.sh_degree, &along);
        let radial = dot(towards, by_direction);
        let turned = each!([0, 1, 2] n => towards[n].mul_add(-radial, by_direction[n]) / distance);
        let (geometry, by_place) = by_geometry(simd, &shape, &flat, seen, (view, turned));
        let mut geometry = geometry;
        let mut all_fit = fits(by_colour[0]) & fits(by_colour[1]) & fits(by_colour[2]);
        for value in &mut geometry {
            *value = touched.select(*value, zero);
            all_fit &= fits(*value);
        }
        let colour = by_colour;
        Self { shape, flat, geometry, colour, basis, by_place, touched, fits: all_fit }
    }

    /// The gradient of a column of numbers, without regularisers.
    #[inline(always)]
    pub(super) fn number(&self, simd: S, column: usize, sh_degree: u32) -> F<S> {
        let Some(harmonic) = column.checked_sub(column::HARMONICS) else {
            return self.geometry[column];
        };
        if harmonic >= 3 * coefficients(sh_degree) {
            return splat(simd, 0.0);
        }
        self.colour[harmonic % 3] * self.basis[harmonic / 3]
    }
}

/// Projection of each active coefficient onto the colour's gradient.
#[inline(always)]
fn weights<S: Simd>(simd: S, harmonics: &[Lanes], by: V3<S>, degree: u32) -> [F<S>; 16] {
    let mut out = [splat(simd, 0.0); 16];
    let (rows, _) = harmonics.as_chunks::<3>();
    for (weight, row) in out.iter_mut().zip(rows).take(coefficients(degree)) {
        *weight = dot(each!([0, 1, 2] n => load(simd, &row[n])), by);
    }
    out
}

/// -conic G conic for the gradient by the conic: the gradient xx, xy, yy by the 2-D covariance.
#[inline(always)]
fn by_flat<S: Simd>([a, b, c]: V3<S>, [by_a, by_b, by_c]: V3<S>) -> V3<S> {
    let half = by_b * 0.5;
    // Columns of G conic.
    let first = [by_a.mul_add(a, half * b), half.mul_add(a, by_c * b)];
    let second = [by_a.mul_add(b, half * c), half.mul_add(b, by_c * c)];
    [
        -a.mul_add(first[0], b * first[1]),
        -a.mul_add(second[0], b * second[1]),
        -b.mul_add(second[0], c * second[1]),
    ]
}

/// The gradients by mean, log-scale, quaternion and logit, and by the mean on the image. `turned`:
/// the mean's share through the direction of the colour.
#[inline(always)]
fn by_geometry<S: Simd>(
    simd: S,
    shape: &Shape<S>,
    flat: &Flat<S>,
    seen: &Seen,
    (view, turned): (&View, V3<S>),
) -> ([F<S>; column::HARMONICS], [F<S>; 2]) {
    let [v, v_x, v_y, v_xx, v_xy, v_yy] = each!([3, 4, 5, 6, 7, 8] n => seen.sum(simd, n));
    let [a, b, c] = flat.conic;
    let by_place = [-a.mul_add(v_x, b * v_y), -b.mul_add(v_x, c * v_y)];
    let by_flat = by_flat(flat.conic, [v_xx * 0.5, v_xy, v_yy * 0.5]);
    let by_point = by_point(simd, flat, view, by_place, by_flat);
    let world = world(simd, view);
    let mean = each!([0, 1, 2] n => {
        dot([world[0][n], world[1][n], world[2][n]], by_point) + turned[n]
    });
    let factors = each!([0, 1, 2] axis => by_factor(shape, flat, by_flat, axis));
    let log_scale = each!([0, 1, 2] axis => {
        dot(factors[axis], shape.rotation[axis]) * shape.scale[axis]
    });
    let by_rotation = each!([0, 1, 2] axis => scaled(factors[axis], shape.scale[axis]));
    let quat = by_quat(shape, &by_rotation);
    let logit = v * (shape.opacity - 1.0);
    let [mx, my, mz] = mean;
    let [sx, sy, sz] = log_scale;
    let [qw, qx, qy, qz] = quat;
    ([mx, my, mz, sx, sy, sz, qw, qx, qy, qz, logit], by_place)
}

/// By a column of R S.
#[inline(always)]
fn by_factor<S: Simd>(shape: &Shape<S>, flat: &Flat<S>, [xx, xy, yy]: V3<S>, axis: usize) -> V3<S> {
    let factor = scaled(shape.rotation[axis], shape.scale[axis]);
    let (x, y) = (dot(flat.linear[0], factor), dot(flat.linear[1], factor));
    let (x, y) = (xx.mul_add(x, xy * y), xy.mul_add(x, yy * y));
    blend(flat.linear[0], x * 2.0, flat.linear[1], y * 2.0)
}

/// By the point in the camera.
#[inline(always)]
fn by_point<S: Simd>(
    simd: S,
    flat: &Flat<S>,
    view: &View,
    by_place: [F<S>; 2],
    [xx, xy, yy]: V3<S>,
) -> V3<S> {
    let by_linear = [
        blend(flat.spread[0], xx * 2.0, flat.spread[1], xy * 2.0),
        blend(flat.spread[0], xy * 2.0, flat.spread[1], yy * 2.0),
    ];
    let world = world(simd, view);
    let (zero, inverse) = (splat(simd, 0.0), flat.inverse_depth);
    let mut by_depth = zero;
    let by_axis = each!([0, 1] n => {
        let over_depth = inverse * view.focal[n];
        let ratio = over_depth * inverse;
        let own = dot(by_linear[n], world[n]);
        // J[axis][2] = -f slope / z, and the slope moves with the point unless it is clamped.
        let third = dot(by_linear[n], world[2]) * ratio;
        let moving = flat.moves[n].select(third, zero);
        by_depth += (third + moving) * flat.slope[n]
            - by_place[n].mul_add(flat.point[n], own) * ratio;
        by_place[n].mul_add(over_depth, -moving)
    });
    [by_axis[0], by_axis[1], by_depth]
}

/// By the quaternion, from the gradient by the rotation's columns.
#[inline(always)]
fn by_quat<S: Simd>(shape: &Shape<S>, g: &[V3<S>; 3]) -> [F<S>; 4] {
    let [w, x, y, z] = shape.unit_quat;
    let sums = [g[1][0] + g[0][1], g[2][0] + g[0][2], g[2][1] + g[1][2]];
    let differences = [g[1][2] - g[2][1], g[2][0] - g[0][2], g[0][1] - g[1][0]];
    let halves = [
        dot([x, y, z], differences),
        y * sums[0] + z * sums[1] + w * differences[0] - x * (g[1][1] + g[2][2]) * 2.0,
        x * sums[0] + z * sums[2] + w * differences[1] - y * (g[0][0] + g[2][2]) * 2.0,
        x * sums[1] + y * sums[2] + w * differences[2] - z * (g[0][0] + g[1][1]) * 2.0,
    ];
    let by_unit = each!([0, 1, 2, 3] n => halves[n] * 2.0);
    let radial = by_unit[0].mul_add(w, dot([by_unit[1], by_unit[2], by_unit[3]], [x, y, z]));
    let unit = shape.unit_quat;
    each!([0, 1, 2, 3] n => unit[n].mul_add(-radial, by_unit[n]) / shape.quat_norm)
}

/// Whether a log-scale is within the range in which it has a gradient.
#[inline(always)]
pub(super) fn moves<S: Simd>(log_scale: F<S>) -> M<S> {
    log_scale.simd_ge(LOG_SCALE_RANGE[0]) & log_scale.simd_le(LOG_SCALE_RANGE[1])
}
