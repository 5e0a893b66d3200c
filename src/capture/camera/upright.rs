//! The direction that is up in a scene, derived only from the cameras of its photographs.

use glam::{DMat3, DVec3};

use super::Camera;

/// How far people hold a camera from level, degrees: its x axis is that far from horizontal.
const ROLL: f64 = 2.5;
/// How far a whole set of photographs looks up or down on average, degrees.
const PITCH: f64 = 15.0;
/// With less of the mean of the images' own upward directions in it, a direction is not up.
const LEAST_SHARE: f64 = 0.1;
/// Length of that mean from which the images have an upward direction in common.
const IN_COMMON: f64 = 0.9;
/// The sine of the greatest roll, in the mean, at which cameras count as level: 10 degrees.
const LEVEL: f64 = 0.17;
/// How much less roll, or how much greater a share, looking straight down must give to be believed.
const LESS_ROLL: f64 = 0.09;
const MORE: f64 = 0.3;
/// The cosine of the least angle between two different answers.
const APART: f64 = 0.7;

/// The unit vector that is up in the world of these cameras; `None` if they do not determine it.
///
/// The x axes of level cameras are horizontal, whatever the cameras look at, so up is perpendicular
/// to all of them. Where they all point one way, which leaves a pitch open, up is as near as
/// possible to the mean of the images' own upward directions: the maximum of the posterior, with
/// errors of [`ROLL`] for each camera and [`PITCH`] for the mean, in its linear form. Cameras that
/// look down from a drone have no such mean: for them up is opposite to where they look. Cameras
/// that look straight up are taken for such, too.
pub fn up(cameras: &[Camera]) -> Option<DVec3> {
    let mut matrix = DMat3::from_diagonal(DVec3::splat((ROLL / PITCH).powi(2)));
    for camera in cameras {
        let x = camera.right();
        matrix += DMat3::from_cols(x * x.x, x * x.y, x * x.z);
    }
    let solve = matrix.inverse();
    let perpendicular = |wanted: DVec3| (solve * wanted).try_normalize();
    let (upward, back) = (-mean(cameras, Camera::down), -mean(cameras, Camera::forward));
    let (level, overhead) = (perpendicular(upward), perpendicular(back));
    let (Some(up), Some(above)) = (level, overhead) else {
        return level.or(overhead);
    };
    let rolls = [up, above].map(|up| roll(cameras, up));
    let shares = [up.dot(upward), above.dot(back)];
    let is_level = rolls[0] < rolls[1] + LESS_ROLL;
    let is_similar = up.dot(above).abs() > APART || shares[1] < shares[0] + MORE;
    let may_be_overhead = upward.length() < IN_COMMON && rolls[1] < LEVEL && shares[1] > MORE;
    let is_overhead = may_be_overhead && !(is_level && is_similar);
    let is_unknown = shares[0] < LEAST_SHARE && shares[0] < shares[1];
    Some(if is_overhead || is_unknown { above } else { up })
}

/// Up for cameras in the world of a map: its z axis, or else another axis, if the cameras are level
/// to it; otherwise [`up`].
pub fn up_of_map(cameras: &[Camera]) -> Option<DVec3> {
    let up = up(cameras)?;
    let axis = [DVec3::Z, DVec3::Y, DVec3::X].into_iter().find(|&axis| roll(cameras, axis) < LEVEL);
    // Where the cameras do not tell the sign, the axis itself points up, as on maps.
    Some(axis.map_or(up, |axis| if up.dot(axis) < -LEAST_SHARE { -axis } else { axis }))
}

/// The root mean square of the sines of the cameras' roll, if that were up.
fn roll(cameras: &[Camera], up: DVec3) -> f64 {
    let squares = cameras.iter().map(|camera| camera.right().dot(up).powi(2));
    (squares.sum::<f64>() / cameras.len() as f64).sqrt()
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

    /// Headings of a flight in `legs` there and back, or all in one direction for one leg.
    fn flown(legs: usize) -> impl Iterator<Item = f64> {
        (0..legs).flat_map(|leg| [180.0 * (leg % 2) as f64; 8])
    }

    #[test]
    fn from_straight_above_the_ground_is_below() {
        let pitched = |pitch| move |heading| [heading, pitch, 0.0];
        let turned = |to: i32| (0..13).map(move |i| f64::from(i * to) / 12.0);
        for pitch in [-90.0, -80.0] {
            for to in [120, 150, 180, 270, 330] {
                let found = error(turned(to).map(pitched(pitch)));
                assert!(found < 2.0, "{found} at headings to {to}, pitch {pitch}");
            }
        }
        for legs in [2, 3, 4, 5, 9] {
            let found = error(flown(legs).map(pitched(-90.0)));
            assert!(found < 0.5, "{found} in {legs} legs");
        }
        let shaky = turned(180).enumerate().map(|(i, heading)| {
            [heading, -90.0 + [1.5, -1.0, 0.5][i % 3], [1.0, -1.5, 0.0, 1.2][i % 4]]
        });
        assert!(error(shaky) < 2.0);
    }

    #[test]
    fn a_ceiling_is_above() {
        assert!(error((0..12).map(|i| [f64::from(i) * 30.0, 75.0, 0.0])) < 0.5);
    }

    #[test]
    fn a_map_keeps_the_axis_to_which_its_cameras_are_level() {
        // Its y points down here, so that is its vertical axis; z and x are horizontal.
        let of = |turns: &[[f64; 3]]| up_of_map(&cameras(turns.iter().copied())).expect("up");
        let around: Vec<_> = (0..12).map(|i| [f64::from(i) * 30.0, -20.0, 3.0]).collect();
        assert_eq!(of(&around), DVec3::NEG_Y);
        // Turned so that z is up, as in UTM: a ring, one oblique leg, and one straight down.
        let turned = |turns: &[[f64; 3]], by: DQuat| -> Vec<Camera> {
            let one = |camera: Camera| {
                let rotation = by * DQuat::from_mat3(&camera.rotation()).inverse();
                Camera::from_pose(camera.intrinsics, rotation.inverse(), DVec3::ZERO)
            };
            cameras(turns.iter().copied()).into_iter().map(one).collect()
        };
        let upright = DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2);
        let one_way = |pitch: f64| vec![[1.0, pitch, 0.5], [-1.0, pitch, -0.5], [0.0, pitch, 0.0]];
        for turns in [around, one_way(-60.0), one_way(-90.0), one_way(0.0)] {
            assert_eq!(up_of_map(&turned(&turns, upright)), Some(DVec3::Z), "{turns:?}");
        }
        // Level to no axis, as where the origin is the middle of the earth.
        let level: Vec<_> = (0..12).map(|i| [f64::from(i) * 30.0, 0.0, 0.0]).collect();
        let aslant = DQuat::from_euler(glam::EulerRot::XYZ, 0.7, 0.4, 0.5);
        let found = up_of_map(&turned(&level, aslant)).expect("up");
        assert!(found.angle_between(aslant * DVec3::NEG_Y) < 0.01, "{found}");
    }

    #[test]
    fn no_cameras_have_no_up() {
        assert_eq!(up(&[]), None);
    }
}
