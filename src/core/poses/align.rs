//! Compares two sets of cameras after aligning position, orientation and scale of their worlds:
//! structure from motion leaves all three free.

use glam::{DMat3, DMat4, DQuat, DVec3};

use crate::camera::Camera;

/// A similarity transform: `to = scale * rotation * from + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Scale.
    pub scale: f64,
    /// Rotation.
    pub rotation: DQuat,
    /// Translation.
    pub translation: DVec3,
}

impl Similarity {
    /// Transforms a point.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.translation
    }

    /// The least-squares rotation and translation between paired points, with the ratio of their
    /// spreads as scale (Horn 1987); `None` for fewer than three points or if all coincide.
    pub fn fit(from: &[DVec3], to: &[DVec3]) -> Option<Self> {
        if from.len() < 3 || from.len() != to.len() {
            return None;
        }
        let (mean_from, mean_to) = (mean(from), mean(to));
        let spread = |points: &[DVec3], mean: DVec3| -> f64 {
            points.iter().map(|p| (*p - mean).length_squared()).sum()
        };
        let (from_spread, to_spread) = (spread(from, mean_from), spread(to, mean_to));
        if from_spread <= 0.0 || to_spread <= 0.0 {
            return None;
        }
        // Row i of the sum is sum(from_i * to).
        let covariance = from.iter().zip(to).fold(DMat3::ZERO, |sum, (a, b)| {
            let (a, b) = (*a - mean_from, *b - mean_to);
            sum + DMat3::from_cols(b * a.x, b * a.y, b * a.z)
        });
        let rotation = horn(&covariance);
        let scale = (to_spread / from_spread).sqrt();
        Some(Self { scale, rotation, translation: mean_to - scale * (rotation * mean_from) })
    }
}

impl Similarity {
    /// The transform that maps most of the cameras of one world to the same cameras in another; a
    /// few may be elsewhere. Uses positions and orientations, so that cameras along a line suffice,
    /// too. `None` for fewer than three, or if all are at one place.
    pub fn between(from: &[Camera], to: &[Camera]) -> Option<Self> {
        let mut kept: Vec<usize> = (0..from.len().min(to.len())).collect();
        let mut fit = of_cameras(&kept, from, to)?;
        for _ in 0..TRIMS {
            let centres: Vec<DVec3> = to.iter().map(Camera::centre).collect();
            let arm = extent(&centres);
            let away = |&index: &usize| {
                let there = around(&to[index], arm);
                let here = around(&fit.camera(&from[index]), arm);
                here.iter().zip(there).map(|(a, b)| a.distance(b)).sum()
            };
            let mut all: Vec<f64> = (0..from.len()).map(|index| away(&index)).collect();
            all.sort_by(f64::total_cmp);
            let most = TRIM * all[all.len() / 2] + 1e-12;
            kept = (0..from.len()).filter(|index| away(index) <= most).collect();
            fit = of_cameras(&kept, from, to)?;
        }
        Some(fit)
    }

    /// Transforms a camera: its view of an equally transformed world is unchanged.
    pub fn camera(&self, camera: &Camera) -> Camera {
        let rotation = camera.rotation() * DMat3::from_quat(self.rotation.inverse());
        let translation = -(rotation * self.apply(camera.centre()));
        Camera { world_to_camera: DMat4::from_mat3_translation(rotation, translation), ..*camera }
    }
}

/// Number of fits, each over those within [`TRIM`] times the median distance in the previous fit.
const TRIMS: usize = 4;
const TRIM: f64 = 2.5;

/// Fits positions and orientations.
fn of_cameras(kept: &[usize], from: &[Camera], to: &[Camera]) -> Option<Similarity> {
    let centres = |cameras: &[Camera]| -> Vec<DVec3> {
        kept.iter().map(|&index| cameras[index].centre()).collect()
    };
    let by_centres = Similarity::fit(&centres(from), &centres(to))?;
    let arm = extent(&centres(to));
    let points = |cameras: &[Camera], arm: f64| -> Vec<DVec3> {
        kept.iter().flat_map(|&index| around(&cameras[index], arm)).collect()
    };
    Similarity::fit(&points(from, arm / by_centres.scale), &points(to, arm))
}

/// A camera's centre, and the points at arm's length to its right and below it.
fn around(camera: &Camera, arm: f64) -> [DVec3; 3] {
    let (centre, back) = (camera.centre(), camera.rotation().transpose());
    [centre, centre + arm * back.x_axis, centre + arm * back.y_axis]
}

fn mean(points: &[DVec3]) -> DVec3 {
    points.iter().sum::<DVec3>() / points.len() as f64
}

/// The rotation that maximises the trace with the covariance: the dominant eigenvector of Horn's
/// 4x4 matrix, by squaring a shifted copy of it (27 doublings raise it to the power 1.3e8).
fn horn(covariance: &DMat3) -> DQuat {
    let s = |i: usize, j: usize| covariance.col(i)[j];
    let n = DMat4::from_cols_array_2d(&[
        [s(0, 0) + s(1, 1) + s(2, 2), s(1, 2) - s(2, 1), s(2, 0) - s(0, 2), s(0, 1) - s(1, 0)],
        [s(1, 2) - s(2, 1), s(0, 0) - s(1, 1) - s(2, 2), s(0, 1) + s(1, 0), s(2, 0) + s(0, 2)],
        [s(2, 0) - s(0, 2), s(0, 1) + s(1, 0), s(1, 1) - s(0, 0) - s(2, 2), s(1, 2) + s(2, 1)],
        [s(0, 1) - s(1, 0), s(2, 0) + s(0, 2), s(1, 2) + s(2, 1), s(2, 2) - s(0, 0) - s(1, 1)],
    ]);
    let norm = |m: &DMat4| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
    // Gershgorin: the shift makes every eigenvalue positive, so the largest is the dominant one.
    let shifted = n + DMat4::from_diagonal(glam::DVec4::splat(norm(&n)));
    let mut power = shifted * (1.0 / norm(&shifted));
    for _ in 0..27 {
        power = power * power;
        power *= 1.0 / norm(&power);
    }
    let columns = [power.x_axis, power.y_axis, power.z_axis, power.w_axis];
    let longest =
        columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    let q = longest.expect("four columns").normalize();
    DQuat::from_xyzw(q.y, q.z, q.w, q.x)
}

/// Errors of cameras against true ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraErrors {
    /// Root mean square distance of the centres over the extent of the true ones.
    pub position_rms: f64,
    /// Largest such share.
    pub position_max: f64,
    /// Largest angle between the orientations, degrees.
    pub rotation_max_degrees: f64,
}

/// Compares paired cameras after a similarity fit of their centres. The extent is the largest
/// distance between two true centres. `None` for fewer than three pairs.
pub fn compare(estimated: &[Camera], truth: &[Camera]) -> Option<CameraErrors> {
    let centres = |cameras: &[Camera]| cameras.iter().map(Camera::centre).collect::<Vec<_>>();
    let (from, to) = (centres(estimated), centres(truth));
    let fit = Similarity::fit(&from, &to)?;
    let extent = extent(&to);
    let shares: Vec<f64> =
        from.iter().zip(&to).map(|(a, b)| fit.apply(*a).distance(*b) / extent).collect();
    let angle = |(a, b): (&Camera, &Camera)| {
        let moved = DQuat::from_mat3(&a.rotation()) * fit.rotation.inverse();
        moved.angle_between(DQuat::from_mat3(&b.rotation())).to_degrees()
    };
    Some(CameraErrors {
        position_rms: (shares.iter().map(|s| s * s).sum::<f64>() / shares.len() as f64).sqrt(),
        position_max: shares.iter().copied().fold(0.0, f64::max),
        rotation_max_degrees: estimated.iter().zip(truth).map(angle).fold(0.0, f64::max),
    })
}

/// Largest distance between two of the points.
pub fn extent(points: &[DVec3]) -> f64 {
    points.iter().flat_map(|a| points.iter().map(|b| a.distance(*b))).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use glam::EulerRot;

    use super::*;
    use crate::camera::Intrinsics;

    fn ring(count: usize) -> Vec<Camera> {
        let k = Intrinsics { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
        let camera = |i: usize| {
            let t = i as f64 * 0.7;
            Camera::look_at(
                k,
                DVec3::new(3.0 * t.cos(), 0.3 * t, 3.0 * t.sin()),
                DVec3::ZERO,
                DVec3::Y,
            )
        };
        (0..count).map(camera).collect()
    }

    /// The same cameras in another world.
    fn moved(cameras: &[Camera], by: &Similarity) -> Vec<Camera> {
        let place = |camera: &Camera| {
            let rotation = DQuat::from_mat3(&camera.rotation()) * by.rotation.inverse();
            let centre = by.apply(camera.centre());
            Camera::from_pose(camera.intrinsics, rotation, -(rotation * centre))
        };
        cameras.iter().map(place).collect()
    }

    #[test]
    fn the_same_cameras_in_another_world_have_no_error_and_a_moved_one_has() {
        for angle in [0.0, 1.0, 3.1, std::f64::consts::PI] {
            let by = Similarity {
                scale: 2.5,
                rotation: DQuat::from_euler(EulerRot::XYZ, angle, 0.3, -angle),
                translation: DVec3::new(4.0, -1.0, 9.0),
            };
            let truth = ring(12);
            let estimated = moved(&truth, &by);
            let errors = compare(&estimated, &truth).expect("twelve");
            assert!(errors.position_max < 1e-9 && errors.rotation_max_degrees < 1e-5, "{errors:?}");
            let mut wrong = estimated.clone();
            wrong[3] = Camera { world_to_camera: estimated[4].world_to_camera, ..estimated[3] };
            let errors = compare(&wrong, &truth).expect("twelve");
            assert!(errors.position_max > 0.1 && errors.rotation_max_degrees > 5.0, "{errors:?}");
        }
    }

    #[test]
    fn most_cameras_determine_the_similarity_even_along_a_line() {
        let by = Similarity {
            scale: 2.5,
            rotation: DQuat::from_euler(EulerRot::XYZ, 1.0, 0.3, -2.0),
            translation: DVec3::new(4.0, -1.0, 9.0),
        };
        let along_a_line = |index: usize| Camera {
            world_to_camera: DMat4::from_translation(DVec3::new(-(index as f64), 0.0, 0.0)),
            ..ring(1)[0]
        };
        for from in [ring(12), (0..12).map(along_a_line).collect()] {
            let mut to: Vec<Camera> = from.iter().map(|camera| by.camera(camera)).collect();
            assert!(compare(&to, &from).is_some_and(|errors| errors.position_max < 1e-9));
            to[3] = to[9];
            let found = Similarity::between(&from, &to).expect("twelve");
            assert!((found.scale - 2.5).abs() < 1e-6, "{found:?}");
            assert!(found.rotation.dot(by.rotation).abs() > 1.0 - 1e-9, "{found:?}");
            assert!(found.translation.distance(by.translation) < 1e-5, "{found:?}");
        }
        assert_eq!(Similarity::between(&ring(2), &ring(2)), None);
    }

    #[test]
    fn cameras_on_a_line_and_two_cameras_are_distinguished() {
        assert!(compare(&ring(2), &ring(2)).is_none());
        assert!(Similarity::fit(&[DVec3::ONE; 4], &[DVec3::ZERO; 4]).is_none());
    }
}
