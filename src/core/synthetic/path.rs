//! The positions of the cameras, and the shake of the hand.

use std::f64::consts::TAU;

use glam::{DQuat, DVec2, DVec3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::camera::{Camera, Intrinsics};

/// The world direction that points down in level images.
const DOWN: DVec3 = DVec3::Y;

/// Views along one closed, wavy loop in front of the scene, all looking near its middle: neighbours
/// overlap widely, no two cameras share a place, and every view has neighbours on both sides, so
/// that a held-out one shows what its neighbours have seen.
pub(super) fn cameras(count: usize, intrinsics: Intrinsics, seed: u64) -> Vec<Camera> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x5eed);
    (0..count)
        .map(|index| {
            let turn = TAU * index as f64 / count as f64;
            let angle = 0.55 * turn.sin();
            let mut jitter = |size: f64| size * (2.0 * rng.random::<f64>() - 1.0);
            let radius = 3.3 + 0.25 * (2.0 * turn).cos() + jitter(0.06);
            let height = 0.42 * turn.cos() + 0.1 * (3.0 * turn).sin();
            let eye = DVec3::new(
                radius * angle.sin() + jitter(0.05),
                -0.35 - height + jitter(0.05),
                -radius * angle.cos(),
            );
            let target = DVec3::new(jitter(0.12), 0.35 + jitter(0.1), 0.6);
            Camera::look_at(intrinsics, eye, target, DOWN)
        })
        .collect()
}

/// `count` moments of one exposure. Rotation and translation follow a smooth random curve whose
/// image in the middle of the frame, at `distance`, is a path of 0.4 to 1 times `blur` px, centred
/// on the camera's pose (so the poses are those of the middle of the blur).
pub(super) fn shake(
    camera: &Camera,
    distance: f64,
    blur: f64,
    count: usize,
    rng: &mut impl Rng,
) -> Vec<Camera> {
    let length = blur * (0.4 + 0.6 * rng.random::<f64>());
    let curve = curve(count, rng);
    let travelled: f64 = curve.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    // A third of a hand's motion is translation, which blurs near objects more than far ones.
    let turning = 0.67;
    let roll = 0.004 * (2.0 * rng.random::<f64>() - 1.0) * blur / 9.0;
    let focal = camera.intrinsics.fx;
    curve
        .iter()
        .enumerate()
        .map(|(index, at)| {
            let pixels = if travelled > 0.0 { *at * (length / travelled) } else { DVec2::ZERO };
            let angle = turning * pixels / focal;
            let along = index as f64 / (count.max(2) - 1) as f64 - 0.5;
            let turn = DQuat::from_rotation_y(angle.x)
                * DQuat::from_rotation_x(-angle.y)
                * DQuat::from_rotation_z(roll * along);
            let shift = (1.0 - turning) * pixels / focal * distance;
            let rotation = turn * DQuat::from_mat3(&camera.rotation());
            let centre = camera.centre() - camera.rotation().transpose() * shift.extend(0.0);
            Camera::from_pose(camera.intrinsics, rotation, -(rotation * centre))
        })
        .collect()
}

/// A smooth plane curve with zero mean: a random direction that drifts, like tremor.
fn curve(count: usize, rng: &mut impl Rng) -> Vec<DVec2> {
    let mut heading = TAU * rng.random::<f64>();
    let mut bend = 0.0;
    let mut at = DVec2::ZERO;
    let mut points = vec![at];
    for _ in 1..count.max(1) {
        bend = 0.7 * bend + 0.35 * (2.0 * rng.random::<f64>() - 1.0);
        heading += bend;
        at += DVec2::from_angle(heading) * (0.6 + 0.8 * rng.random::<f64>());
        points.push(at);
    }
    let mean = points.iter().sum::<DVec2>() / points.len() as f64;
    points.iter().map(|p| *p - mean).collect()
}
