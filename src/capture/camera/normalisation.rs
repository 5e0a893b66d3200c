//! Removes the position and size of a world before anything becomes `f32`: a capture in UTM metres
//! or in millimetres trains like one of ordinary size around the origin.

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::Camera;

/// The scale is a power of this, so that it causes no rounding and worlds of ordinary size, such as
/// COLMAP's, are unchanged. The only length that does not scale with the scene is the near plane of
/// 0.01: it is within 0.5 % of the scene's distance.
const SCALE_STEP: f64 = 16.0;

/// Smallest viewing distance of a scene after scaling; it stays below [`SCALE_STEP`] times this.
const LEAST_SIZE: f64 = 2.0;

/// The offset is a multiple of four to eight sizes of the scene: short to write, exact to subtract,
/// and zero for a scene around the origin.
const OFFSET_STEP: f64 = 4.0;

/// Coarsest step of `f32` in files, as a share of the scene's size.
const COARSEST: f64 = 1e-4;

/// Cameras farther from the middle than this many median distances are ignored.
const OUTLYING: f64 = 10.0;

/// The similarity from a world, the given or COLMAP's, to the one in which a scene trains:
/// `trained = (world - offset) * scale`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Normalisation {
    /// World units.
    pub offset: DVec3,
    /// Trained units per world unit.
    pub scale: f64,
    /// Whether PLY files, which store `f32`, leave the offset out.
    pub left_out: bool,
}

impl Default for Normalisation {
    fn default() -> Self {
        Self { offset: DVec3::ZERO, scale: 1.0, left_out: false }
    }
}

impl Normalisation {
    /// For the world of these cameras; the identity if they do not determine its size.
    pub fn of(cameras: &[Camera]) -> Self {
        let Some(first) = cameras.first().map(place) else {
            return Self::default();
        };
        let near_first = Self { offset: first, ..Self::default() };
        let moved: Vec<Camera> = cameras.iter().map(|c| near_first.within(c)).collect();
        let (middle, inlying) = inlying(&moved);
        let size = viewing_distance(&inlying);
        if !(size.is_finite() && size > 0.0) {
            return Self::default();
        }
        let step = OFFSET_STEP * size.log2().floor().exp2();
        // Adding zero turns a negative zero positive.
        let offset = ((first + middle) / step).round() * step + DVec3::ZERO;
        let largest = offset.abs().max_element();
        let of_f32 = (largest.log2().floor() - f64::from(f32::MANTISSA_DIGITS - 1)).exp2();
        let steps = (size / LEAST_SIZE).log(SCALE_STEP).floor();
        Self { offset, scale: SCALE_STEP.powi(-(steps as i32)), left_out: of_f32 > COARSEST * size }
    }

    /// From the same world with `factor` times its lengths.
    #[must_use]
    pub fn of_scaled_world(self, factor: f64) -> Self {
        Self { offset: factor * self.offset, scale: self.scale / factor, ..self }
    }

    /// Whether it changes nothing.
    pub fn is_identity(&self) -> bool {
        *self == Self::default()
    }

    /// Transforms a world point to the trained world.
    pub fn point_within(&self, world: DVec3) -> DVec3 {
        (world - self.offset) * self.scale
    }

    /// Transforms a trained point to the world.
    pub fn point_in_world(&self, trained: DVec3) -> DVec3 {
        trained / self.scale + self.offset
    }

    /// Transforms a world camera to the trained world. Its rotation becomes exact: far from the
    /// origin a rotation of six digits shifts the view by metres.
    #[must_use]
    pub fn within(&self, camera: &Camera) -> Camera {
        if self.is_identity() {
            return *camera;
        }
        let rotation = DQuat::from_mat3(&camera.rotation()).normalize();
        let centre = self.point_within(place(camera));
        Camera::from_pose(camera.intrinsics, rotation, -(rotation * centre))
    }

    /// Transforms a trained camera to the world.
    #[must_use]
    pub fn in_world(&self, camera: &Camera) -> Camera {
        if self.is_identity() {
            return *camera;
        }
        let rotation = DQuat::from_mat3(&camera.rotation()).normalize();
        let centre = self.point_in_world(camera.centre());
        Camera::from_pose(camera.intrinsics, rotation, -(rotation * centre))
    }

    /// The offset missing from the coordinates in PLY files.
    pub fn missing_in_files(&self) -> DVec3 {
        if self.left_out { self.offset } else { DVec3::ZERO }
    }
}

/// The position of a camera, exact even if its matrix is not an exact rotation.
fn place(camera: &Camera) -> DVec3 {
    -(camera.rotation().inverse() * camera.translation())
}

/// The middle of the cameras, and the cameras that are not outliers.
fn inlying(cameras: &[Camera]) -> (DVec3, Vec<Camera>) {
    let axis = |axis: usize| median(cameras.iter().map(|camera| camera.centre()[axis]));
    let middle = DVec3::new(axis(0), axis(1), axis(2));
    let away = |camera: &Camera| camera.centre().distance(middle);
    let reach = OUTLYING * median(cameras.iter().map(away));
    let inlying = cameras.iter().filter(|camera| away(camera) <= reach);
    (middle, inlying.copied().collect())
}

/// Median distance of cameras from their common target or, if they look in parallel or outwards,
/// twice their extent; 0 if all are at one place.
pub fn viewing_distance(cameras: &[Camera]) -> f64 {
    let centres: Vec<DVec3> = cameras.iter().map(Camera::centre).collect();
    let apart = centres.iter().flat_map(|a| centres.iter().map(|b| a.distance(*b)));
    let extent = apart.fold(0.0, f64::max);
    if extent <= 0.0 {
        return 0.0;
    }
    // Least squares: sum over cameras of (I - f f^T)(x - c) = 0.
    let mut matrix = DMat3::ZERO;
    let mut vector = DVec3::ZERO;
    for (camera, centre) in cameras.iter().zip(&centres) {
        let f = camera.forward();
        let across = DMat3::IDENTITY - DMat3::from_cols(f * f.x, f * f.y, f * f.z);
        matrix += across;
        vector += across * *centre;
    }
    let conditioned = matrix.determinant() > 1e-4 * (cameras.len() as f64).powi(3);
    let focus = matrix.inverse() * vector;
    let depths =
        cameras.iter().zip(&centres).map(|(camera, centre)| camera.forward().dot(focus - *centre));
    // A focus behind the cameras means that they look outwards.
    let depth = if conditioned { median(depths) } else { 0.0 };
    if depth > 1e-6 * extent { depth } else { 2.0 * extent }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests;
