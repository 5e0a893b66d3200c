//! Rotations written by other programs.

use glam::DMat3;

/// Lengths and right angles that are off by less differ only by rounding.
const EXACT: f64 = 1e-3;

/// Axes that differ more from those of a rotation, after removing their common length, are not
/// rounding errors.
const BENT: f64 = 0.05;

/// The intended rotation of a matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    /// Orthonormal.
    pub matrix: DMat3,
    /// The original length of its axes.
    pub scale: f64,
    /// Whether the correction exceeded rounding.
    pub is_mended: bool,
}

/// The nearest rotation to a matrix that is one except for scale or rounding.
///
/// # Errors
/// Describes the matrix if it is not.
pub fn rotation(matrix: DMat3) -> Result<Rotation, String> {
    let determinant = matrix.determinant();
    if !matrix.is_finite() || !determinant.is_finite() {
        return Err("is not finite".to_owned());
    }
    if determinant < 0.0 {
        return Err("is a mirror image and no rotation (its determinant is negative)".to_owned());
    }
    let scale = determinant.cbrt();
    let unit = matrix * (1.0 / scale);
    // Newton's iteration for the polar decomposition.
    let nearest = (0..20).fold(unit, |q, _| (q + q.inverse().transpose()) * 0.5);
    let off = (unit - nearest).to_cols_array().map(f64::abs);
    let off = off.into_iter().fold(0.0, f64::max);
    if !(nearest.is_finite() && off < BENT) {
        return Err(
            "is no rotation (its axes are not of one length and at right angles)".to_owned()
        );
    }
    Ok(Rotation { matrix: nearest, scale, is_mended: off.max((scale - 1.0).abs()) > EXACT })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_scaled_or_rounded_rotation_is_found_again(
            axis in prop::array::uniform3(-1.0..1.0f64),
            angle in -3.0..3.0f64,
            scale in 0.01..100.0f64,
            digits in 2..6i32,
        ) {
            let axis = DVec3::from(axis);
            prop_assume!(axis.length() > 0.1);
            let true_one = DMat3::from_quat(DQuat::from_axis_angle(axis.normalize(), angle));
            let step = 10f64.powi(-digits);
            let rounded = |m: DMat3| {
                DMat3::from_cols_array(&m.to_cols_array().map(|v| (v / step).round() * step))
            };
            let found = rotation(rounded(true_one) * scale).unwrap();
            prop_assert!(found.matrix.abs_diff_eq(true_one, 2.0 * step));
            prop_assert!((found.scale / scale - 1.0).abs() < 3.0 * step);
            let product = found.matrix * found.matrix.transpose();
            prop_assert!(product.abs_diff_eq(DMat3::IDENTITY, 1e-12));
            let mirrored = true_one * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
            prop_assert!(rotation(mirrored * scale).unwrap_err().contains("mirror"));
        }
    }

    #[test]
    fn matrices_that_are_not_rotations_are_refused() {
        let stretched = DMat3::from_diagonal(DVec3::new(1.0, 1.3, 1.0));
        assert!(rotation(stretched).unwrap_err().contains("right angles"));
        assert!(rotation(DMat3::ZERO).is_err());
        assert!(rotation(DMat3::NAN).unwrap_err().contains("finite"));
        assert!(!rotation(DMat3::IDENTITY).unwrap().is_mended);
    }
}
