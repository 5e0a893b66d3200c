//! Cameras on an orbit around the scene, derived only from the cameras of its photographs.

use glam::{DMat3, DVec3};

use super::upright::{mean, up};
use super::{Camera, Intrinsics, NamedCamera};

/// Weight of the guess "in front of the photographers" against the intersection of their lines of
/// sight, per photograph. Parallel lines do not intersect, and then the guess decides.
const GUESS_WEIGHT: f64 = 1e-3;
/// Highest absolute elevation, degrees: at the pole up is undefined.
const STEEPEST: f64 = 85.0;
/// Photographers this near to the vertical through the centre, as a share of their distance, are
/// above it: the lower edges of their images are towards them.
const OVERHEAD: f64 = 0.05;

/// An orbit. Azimuth 0, elevation 0 and distance 1 are the middle of the photographers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// The point that the photographers looked at, world units.
    pub centre: DVec3,
    /// Their median distance from it, world units.
    pub radius: f64,
    /// Up, to the right and towards the photographers, orthonormal.
    axes: [DVec3; 3],
    /// Their mean elevation, radians.
    elevation: f64,
    intrinsics: Intrinsics,
}

impl Orbit {
    /// From the cameras of a scene; `None` if there are none or they do not determine directions.
    pub fn from_cameras(cameras: &[NamedCamera]) -> Option<Self> {
        let intrinsics = cameras.first()?.intrinsics;
        let cameras: Vec<Camera> = cameras.iter().map(NamedCamera::camera).collect();
        let up = up(&cameras)?;
        let middle = mean(&cameras, Camera::centre);
        let centre = look_at_point(&cameras, middle)?;
        let towards = middle - centre;
        let levelled = |direction: DVec3| direction - up * direction.dot(up);
        let mut level = levelled(towards);
        if level.length() < OVERHEAD * towards.length() {
            level = levelled(mean(&cameras, Camera::down));
        }
        let level = level.try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
        let mut distances: Vec<f64> = cameras.iter().map(|c| c.centre().distance(centre)).collect();
        distances.sort_by(f64::total_cmp);
        let radius = distances[distances.len() / 2];
        let elevation = towards.dot(up).atan2(towards.dot(level));
        (radius.is_finite() && radius > 0.0).then_some(Self {
            centre,
            radius,
            axes: [up, up.cross(level), level],
            elevation,
            intrinsics,
        })
    }

    /// The camera at `azimuth` (degrees, positive to the right) and `elevation` (degrees, positive
    /// up) from the middle of the photographers, at `distance` times their median distance,
    /// looking at the centre, with the field of view of the first photograph.
    pub fn camera(
        &self,
        azimuth: f64,
        elevation: f64,
        distance: f64,
        (width, height): (usize, usize),
    ) -> Camera {
        let steepest = STEEPEST.to_radians();
        let (azimuth, elevation) = (
            azimuth.to_radians(),
            (elevation.to_radians() + self.elevation).clamp(-steepest, steepest),
        );
        let [up, right, towards] = self.axes;
        let level = towards * azimuth.cos() + right * azimuth.sin();
        let direction = level * elevation.cos() + up * elevation.sin();
        let eye = self.centre + direction * (self.radius * distance);
        Camera::look_at(self.fitted(width, height), eye, self.centre, -up)
    }

    /// The position of a camera around the centre, degrees to the right of the middle of the
    /// photographers, -180 to 180.
    pub fn azimuth_of(&self, camera: &Camera) -> f64 {
        let [_, right, towards] = self.axes;
        let place = camera.centre() - self.centre;
        place.dot(right).atan2(place.dot(towards)).to_degrees()
    }

    /// The photograph's field of view in an image of another shape: all of it is visible.
    fn fitted(&self, width: usize, height: usize) -> Intrinsics {
        let k = &self.intrinsics;
        let scale = (width as f64 / k.width as f64).min(height as f64 / k.height as f64);
        Intrinsics {
            width,
            height,
            fx: k.fx * scale,
            fy: k.fy * scale,
            cx: width as f64 / 2.0,
            cy: height as f64 / 2.0,
        }
    }
}

/// The point nearest to all optical axes, least squares, with a small weight on a guess in front.
fn look_at_point(cameras: &[Camera], middle: DVec3) -> Option<DVec3> {
    let spread = cameras.iter().map(|c| c.centre().distance(middle)).fold(0.0, f64::max);
    let forward = mean(cameras, Camera::forward).try_normalize();
    let guess =
        middle + forward.unwrap_or(DVec3::ZERO) * if spread > 0.0 { 2.0 * spread } else { 1.0 };
    let weight = GUESS_WEIGHT * cameras.len() as f64;
    let (mut matrix, mut vector) = (DMat3::from_diagonal(DVec3::splat(weight)), guess * weight);
    for camera in cameras {
        let f = camera.forward();
        // Projects onto the plane across the optical axis: distance along the axis costs nothing.
        let across = DMat3::IDENTITY - DMat3::from_cols(f * f.x, f * f.y, f * f.z);
        matrix += across;
        vector += across * camera.centre();
    }
    let point = matrix.inverse() * vector;
    let in_front = forward.is_none_or(|forward| (point - middle).dot(forward) > 0.0);
    let chosen = if in_front && point.is_finite() { point } else { guess };
    chosen.is_finite().then_some(chosen)
}

#[cfg(test)]
mod tests {
    use super::super::Split;
    use super::*;

    fn ring(centre: DVec3, radius: f64, degrees: f64) -> Vec<NamedCamera> {
        let k = Intrinsics { width: 200, height: 100, fx: 150.0, fy: 150.0, cx: 100.0, cy: 50.0 };
        (-3..=3)
            .map(|i| {
                let angle = (f64::from(i) * degrees / 3.0).to_radians();
                let eye = centre + DVec3::new(angle.sin(), -0.2, -angle.cos()) * radius;
                NamedCamera::new(
                    format!("{i}"),
                    &Camera::look_at(k, eye, centre, DVec3::Y),
                    Split::Train,
                )
            })
            .collect()
    }

    #[test]
    fn the_centre_is_where_the_photographers_look() {
        let centre = DVec3::new(3.0, 1.0, 7.0);
        let orbit = Orbit::from_cameras(&ring(centre, 4.0, 60.0)).expect("an orbit");
        assert!((orbit.centre - centre).length() < 0.05, "{}", orbit.centre);
        assert!((orbit.radius - 4.0 * 1.04_f64.sqrt()).abs() < 0.05, "{}", orbit.radius);
    }

    #[test]
    fn azimuth_zero_is_the_middle_photograph_and_positive_is_right() {
        let cameras = ring(DVec3::ZERO, 4.0, 60.0);
        let orbit = Orbit::from_cameras(&cameras).expect("an orbit");
        let middle = cameras[3].camera();
        let front = orbit.camera(0.0, 0.0, 1.0, (200, 100));
        // The mean of a wide ring is inside it, so it sees the centre a few degrees steeper.
        assert!(front.forward().angle_between(middle.forward()).to_degrees() < 5.0);
        let right = orbit.camera(20.0, 0.0, 1.0, (200, 100));
        let moved = front.world_to_camera.transform_point3(right.centre());
        assert!(moved.x > 0.5, "a positive azimuth goes right: {moved}");
        assert!((orbit.azimuth_of(&right) - 20.0).abs() < 1e-9);
        let high = orbit.camera(0.0, 20.0, 2.0, (200, 100));
        let moved = front.world_to_camera.transform_point3(high.centre());
        assert!(moved.y < -0.5, "a positive elevation goes up: {moved}");
        assert!((high.centre().distance(orbit.centre) - 2.0 * orbit.radius).abs() < 1e-9);
    }

    #[test]
    fn parallel_photographs_and_a_single_one_have_an_orbit_in_front() {
        let k = ring(DVec3::ZERO, 1.0, 1.0)[0].intrinsics;
        let row: Vec<NamedCamera> = (0..5)
            .map(|i| {
                let eye = DVec3::X * f64::from(i);
                NamedCamera::new(
                    "v",
                    &Camera::look_at(k, eye, eye + DVec3::Z, DVec3::Y),
                    Split::Train,
                )
            })
            .collect();
        for cameras in [&row[..], &row[..1]] {
            let orbit = Orbit::from_cameras(cameras).expect("an orbit");
            assert!(orbit.centre.z > 0.1, "{}", orbit.centre);
        }
        assert_eq!(Orbit::from_cameras(&[]), None);
    }
}
