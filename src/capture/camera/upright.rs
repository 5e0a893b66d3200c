//! The direction that is up in a scene, derived only from the cameras of its photographs.

use glam::{DMat3, DVec3};

use super::Camera;

/// How far people hold a camera from level, degrees: its x axis is that far from horizontal.
const ROLL: f64 = 2.5;
/// How far a whole set of photographs looks up or down on average, degrees.
const PITCH: f64 = 15.0;
/// Below this share of upward in the images' own upward, the cameras look straight down or up.
const LEAST_SHARE: f64 = 0.1;

/// The unit vector that is up in the world of these cameras; `None` if they do not determine it.
///
/// The x axes of level cameras are horizontal, whatever the cameras look at, so up is across all of
/// them. Where they all point one way, which leaves a pitch open, up is as near as possible to the
/// mean of the images' own upward directions: the maximum of the posterior, with errors of [`ROLL`]
/// for each camera and [`PITCH`] for the mean, in its linear form.
pub fn up(cameras: &[Camera]) -> Option<DVec3> {
    let mut matrix = DMat3::from_diagonal(DVec3::splat((ROLL / PITCH).powi(2)));
    for camera in cameras {
        let x = camera.right();
        matrix += DMat3::from_cols(x * x.x, x * x.y, x * x.z);
    }
    let solve = matrix.inverse();
    let upward = -mean(cameras, Camera::down);
    let across = |wanted: DVec3| (solve * wanted).try_normalize();
    match across(upward) {
        Some(up) if up.dot(upward) >= LEAST_SHARE => Some(up),
        // Seen from a drone, whose images have no upward in common, the ground is ahead.
        _ => across(-mean(cameras, Camera::forward)),
    }
}

/// The mean of a direction of the cameras; NaN without any.
pub(super) fn mean(cameras: &[Camera], of: fn(&Camera) -> DVec3) -> DVec3 {
    cameras.iter().map(of).sum::<DVec3>() / cameras.len() as f64
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::super::Intrinsics;
    use super::*;

    /// Cameras in a world whose y points down: headings to the right, the pitch upward, and the
    /// roll, degrees.
    fn cameras(turns: impl IntoIterator<Item = [f64; 3]>) -> Vec<Camera> {
        let k = Intrinsics { width: 200, height: 100, fx: 150.0, fy: 150.0, cx: 100.0, cy: 50.0 };
        let one = |turns: [f64; 3]| {
            let [heading, pitch, roll] = turns.map(f64::to_radians);
            let rotation = DQuat::from_rotation_y(heading)
                * DQuat::from_rotation_x(pitch)
                * DQuat::from_rotation_z(roll);
            Camera::from_pose(k, rotation.inverse(), DVec3::ZERO)
        };
        turns.into_iter().map(one).collect()
    }

    fn error(turns: impl IntoIterator<Item = [f64; 3]>) -> f64 {
        up(&cameras(turns)).expect("an upward direction").angle_between(-DVec3::Y).to_degrees()
    }

    #[test]
    fn cameras_that_look_down_from_one_side_know_what_is_up() {
        let arc = |i: i32| [f64::from(i) * 4.0, -40.0, if i % 2 == 0 { 1.5 } else { -1.5 }];
        assert!(error((-10..=10).map(arc)) < 1.0);
        // The images' own upward directions have a mean that is far from it.
        let mean = mean(&cameras((-10..=10).map(arc)), Camera::down);
        assert!(mean.angle_between(DVec3::Y).to_degrees() > 30.0);
    }

    #[test]
    fn where_all_look_one_way_up_is_that_of_the_images() {
        let row = (0..20).map(|i| [0.0, 3.0, if i % 2 == 0 { 1.0 } else { -1.0 }]);
        assert!((error(row) - 3.0).abs() < 0.1);
        assert!((error([[20.0, -10.0, 0.0]]) - 10.0).abs() < 0.1);
    }

    #[test]
    fn from_straight_above_the_ground_is_below() {
        assert!(error((0..12).map(|i| [f64::from(i) * 30.0, -90.0, 0.0])) < 1e-6);
        assert!(error((0..12).map(|i| [f64::from(i) * 30.0, -80.0, 0.0])) < 1e-6);
    }

    #[test]
    fn no_cameras_have_no_up() {
        assert_eq!(up(&[]), None);
    }
}
