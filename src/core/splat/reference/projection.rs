//! Projection of one Gaussian (EWA splatting) and its gradient.

use glam::{DMat2, DMat3, DVec2, DVec3};

use super::harmonics::{basis, basis_gradient, coefficients};
use super::{Splat, Viewpoint};

/// Added to the diagonal of every 2-D covariance, px^2, so that no splat is thinner than about a
/// pixel.
pub const LOW_PASS: f64 = 0.3;
/// Least determinant of a covariance, px^4; smaller ones are culled, because the backward pass
/// divides by its square.
pub const DETERMINANT_GUARD: f64 = 1e-6;
/// Limit of the Jacobian's position, in half fields of view off the axis.
pub const FOV_CLAMP: f64 = 1.3;
/// Least alpha that is blended.
pub const ALPHA_CUT: f64 = 1.0 / 255.0;
/// Squared norm below which a quaternion has no direction and is culled.
pub const QUAT_GUARD: f64 = 1e-8;
/// Range of the exponentiated log-scale; outside it the gradient is zero.
pub const LOG_SCALE_RANGE: (f64, f64) = (-30.0, 20.0);

/// A splat on the image plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Projected {
    /// px.
    pub mean: [f64; 2],
    /// Inverse covariance a, b, c: exponent 0.5 (a dx^2 + c dy^2) + b dx dy.
    pub conic: [f64; 3],
    /// After the sigmoid.
    pub opacity: f64,
    /// RGB, at least 0.
    pub colour: [f64; 3],
    /// z in the camera, world units.
    pub depth: f64,
    /// Half size of the largest box that it can touch, px.
    pub extent: [f64; 2],
}

/// The gradient by the values of a [`Projected`] that blending reads.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProjectedGradient {
    /// By the mean.
    pub mean: [f64; 2],
    /// By the conic's a, b, c.
    pub conic: [f64; 3],
    /// By the colour.
    pub colour: [f64; 3],
    /// By the opacity after the sigmoid.
    pub opacity: f64,
}

/// 1 / (1 + e^-x).
pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// Rotation of a unit quaternion w, x, y, z.
pub fn rotation(q: [f64; 4]) -> DMat3 {
    let [w, x, y, z] = q;
    DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// The values shared by forward and backward pass.
struct Intermediate {
    world_to_camera: DMat3,
    point: DVec3,
    /// x/z and y/z, clamped, and whether the clamp was active.
    slope: DVec2,
    clamped: [bool; 2],
    /// First two rows of J W, the third zero.
    linear: DMat3,
    unit_quat: [f64; 4],
    quat_norm: f64,
    scale: DVec3,
    scale_clamped: [bool; 3],
    rotation: DMat3,
    covariance: DMat3,
    /// 2-D covariance a, b, c with the low-pass.
    flat: [f64; 3],
    determinant: f64,
    opacity: f64,
}

fn intermediate(splat: &Splat, view: &Viewpoint) -> Option<Intermediate> {
    let world_to_camera = view.camera.rotation();
    let point = world_to_camera * DVec3::from(splat.mean) + view.camera.translation();
    let norm2: f64 = splat.quat.iter().map(|v| v * v).sum();
    let finite = splat.flatten().iter().all(|v| v.is_finite());
    if !finite || point.z < view.near || norm2 < QUAT_GUARD {
        return None;
    }
    let k = &view.camera.intrinsics;
    let (slope, clamped) = clamped_slope(k, point);
    let jacobian = DMat3::from_cols(
        DVec3::new(k.fx / point.z, 0.0, 0.0),
        DVec3::new(0.0, k.fy / point.z, 0.0),
        DVec3::new(-k.fx * slope.x / point.z, -k.fy * slope.y / point.z, 0.0),
    );
    let linear = jacobian * world_to_camera;
    let quat_norm = norm2.sqrt();
    let unit_quat = splat.quat.map(|v| v / quat_norm);
    let (low, high) = LOG_SCALE_RANGE;
    let scale = DVec3::from(splat.log_scale.map(|v| v.clamp(low, high).exp()));
    let rotation = rotation(unit_quat);
    let factor = rotation * DMat3::from_diagonal(scale);
    let covariance = factor * factor.transpose();
    let projected = linear * covariance * linear.transpose();
    let flat = [projected.x_axis.x + LOW_PASS, projected.x_axis.y, projected.y_axis.y + LOW_PASS];
    let determinant = flat[0] * flat[2] - flat[1] * flat[1];
    let usable = determinant.is_finite() && determinant > DETERMINANT_GUARD;
    usable.then(|| Intermediate {
        world_to_camera,
        point,
        slope,
        clamped,
        linear,
        unit_quat,
        quat_norm,
        scale,
        scale_clamped: splat.log_scale.map(|v| v < low || v > high),
        rotation,
        covariance,
        flat,
        determinant,
        opacity: sigmoid(splat.opacity_logit),
    })
}

fn clamped_slope(k: &crate::camera::Intrinsics, point: DVec3) -> (DVec2, [bool; 2]) {
    let slope = DVec2::new(point.x, point.y) / point.z;
    let size = DVec2::new(k.width as f64, k.height as f64);
    let focal = DVec2::new(k.fx, k.fy);
    let centre = DVec2::new(k.cx, k.cy);
    let margin = (FOV_CLAMP - 1.0) * 0.5 * size / focal;
    let limited = slope.clamp(-centre / focal - margin, (size - centre) / focal + margin);
    (limited, [limited.x != slope.x, limited.y != slope.y])
}

fn direction(splat: &Splat, view: &Viewpoint) -> (DVec3, f64) {
    let offset = DVec3::from(splat.mean) - view.camera.centre();
    let length = offset.length().max(1e-12);
    (offset / length, length)
}

fn unclamped_colour(splat: &Splat, view: &Viewpoint, direction: DVec3) -> [f64; 3] {
    let values = basis(direction.to_array());
    let mut colour = [0.5; 3];
    for (coefficient, value) in splat.sh.iter().zip(values).take(coefficients(view.sh_degree)) {
        for c in 0..3 {
            colour[c] += coefficient[c] * value;
        }
    }
    colour
}

/// Projects one splat; `None` if culled.
pub fn project(splat: &Splat, view: &Viewpoint) -> Option<Projected> {
    let i = intermediate(splat, view)?;
    let k = &view.camera.intrinsics;
    let limit = (255.0 * i.opacity).ln();
    if limit < 0.0 {
        return None;
    }
    let extent = [(2.0 * limit * i.flat[0]).sqrt(), (2.0 * limit * i.flat[2]).sqrt()];
    let mean = [k.fx * i.point.x / i.point.z + k.cx, k.fy * i.point.y / i.point.z + k.cy];
    let outside = |axis: usize, size: usize| {
        mean[axis] + extent[axis] <= 0.0 || mean[axis] - extent[axis] >= size as f64
    };
    if outside(0, k.width) || outside(1, k.height) {
        return None;
    }
    let [a, b, c] = i.flat;
    Some(Projected {
        mean,
        conic: [c / i.determinant, -b / i.determinant, a / i.determinant],
        opacity: i.opacity,
        colour: unclamped_colour(splat, view, direction(splat, view).0).map(|v| v.max(0.0)),
        depth: i.point.z,
        extent,
    })
}

/// The gradient by every parameter of the splat; zero if culled.
pub fn project_backward(splat: &Splat, view: &Viewpoint, gradient: &ProjectedGradient) -> Splat {
    let mut out = Splat::zero(splat.sh.len());
    let (Some(i), Some(_)) = (intermediate(splat, view), project(splat, view)) else {
        return out;
    };
    let by_flat = conic_backward(&i, gradient.conic);
    let by_covariance = i.linear.transpose() * by_flat * i.linear;
    let by_linear = 2.0 * by_flat * i.linear * i.covariance;
    let by_jacobian = by_linear * i.world_to_camera.transpose();
    let by_point = point_backward(&i, view, gradient.mean, by_jacobian);
    let by_mean =
        i.world_to_camera.transpose() * by_point + colour_backward(splat, view, gradient, &mut out);
    out.mean = by_mean.to_array();
    covariance_backward(&i, by_covariance, &mut out);
    out.opacity_logit = gradient.opacity * i.opacity * (1.0 - i.opacity);
    out
}

/// d(cov^-1) = -cov^-1 d(cov) cov^-1.
fn conic_backward(i: &Intermediate, by_conic: [f64; 3]) -> DMat3 {
    let [a, b, c] = i.flat;
    let conic = DMat2::from_cols_array(&[c, -b, -b, a]) * (1.0 / i.determinant);
    let upstream =
        DMat2::from_cols_array(&[by_conic[0], by_conic[1] / 2.0, by_conic[1] / 2.0, by_conic[2]]);
    let flat = conic * upstream * conic * -1.0;
    DMat3::from_cols(flat.x_axis.extend(0.0), flat.y_axis.extend(0.0), DVec3::ZERO)
}

fn point_backward(
    i: &Intermediate,
    view: &Viewpoint,
    by_mean: [f64; 2],
    by_jacobian: DMat3,
) -> DVec3 {
    let k = &view.camera.intrinsics;
    let (z, focal) = (i.point.z, [k.fx, k.fy]);
    let place = [i.point.x, i.point.y];
    let mut by_point = [0.0; 3];
    for axis in 0..2 {
        let f = focal[axis];
        by_point[axis] += by_mean[axis] * f / z;
        by_point[2] -= by_mean[axis] * f * place[axis] / (z * z);
        by_point[2] -= by_jacobian.col(axis)[axis] * f / (z * z);
        let by_third = by_jacobian.z_axis[axis];
        // J[axis][2] = -f slope / z, and slope = place / z moves with the point unless clamped.
        by_point[2] += by_third * f * i.slope[axis] / (z * z);
        if !i.clamped[axis] {
            by_point[axis] -= by_third * f / (z * z);
            by_point[2] += by_third * f * i.slope[axis] / (z * z);
        }
    }
    DVec3::from(by_point)
}

fn covariance_backward(i: &Intermediate, by_covariance: DMat3, out: &mut Splat) {
    let factor = i.rotation * DMat3::from_diagonal(i.scale);
    let by_factor = 2.0 * by_covariance * factor;
    for axis in 0..3 {
        if !i.scale_clamped[axis] {
            out.log_scale[axis] = by_factor.col(axis).dot(i.rotation.col(axis)) * i.scale[axis];
        }
    }
    let g = by_factor * DMat3::from_diagonal(i.scale);
    let r = |row: usize, col: usize| g.col(col)[row];
    let [w, x, y, z] = i.unit_quat;
    let by_unit = [
        2.0 * (x * (r(2, 1) - r(1, 2)) + y * (r(0, 2) - r(2, 0)) + z * (r(1, 0) - r(0, 1))),
        2.0 * (y * (r(0, 1) + r(1, 0)) + z * (r(0, 2) + r(2, 0)) + w * (r(2, 1) - r(1, 2)))
            - 4.0 * x * (r(1, 1) + r(2, 2)),
        2.0 * (x * (r(0, 1) + r(1, 0)) + z * (r(1, 2) + r(2, 1)) + w * (r(0, 2) - r(2, 0)))
            - 4.0 * y * (r(0, 0) + r(2, 2)),
        2.0 * (x * (r(0, 2) + r(2, 0)) + y * (r(1, 2) + r(2, 1)) + w * (r(1, 0) - r(0, 1)))
            - 4.0 * z * (r(0, 0) + r(1, 1)),
    ];
    let radial: f64 = by_unit.iter().zip(i.unit_quat).map(|(g, q)| g * q).sum();
    for (n, by_component) in by_unit.into_iter().enumerate() {
        out.quat[n] = (by_component - i.unit_quat[n] * radial) / i.quat_norm;
    }
}

/// Fills the harmonics' gradient and returns the mean's share through the viewing direction.
fn colour_backward(
    splat: &Splat,
    view: &Viewpoint,
    gradient: &ProjectedGradient,
    out: &mut Splat,
) -> DVec3 {
    let (direction, length) = direction(splat, view);
    let colour = unclamped_colour(splat, view, direction);
    let values = basis(direction.to_array());
    let slopes = basis_gradient(direction.to_array());
    let mut by_direction = DVec3::ZERO;
    for n in 0..splat.sh.len().min(coefficients(view.sh_degree)) {
        for (c, unclamped) in colour.into_iter().enumerate() {
            // The clamp at 0 gates the gradient.
            if unclamped > 0.0 {
                out.sh[n][c] = gradient.colour[c] * values[n];
                by_direction += DVec3::from(slopes[n]) * (gradient.colour[c] * splat.sh[n][c]);
            }
        }
    }
    (by_direction - direction * direction.dot(by_direction)) / length
}
