//! Camera paths through a scene.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};

use super::spline::Spline;
use crate::camera::orbit::Orbit;
use crate::camera::{Camera, Intrinsics, NamedCamera};

/// Photographers who left no gap this wide, degrees, went all around.
const WIDEST_GAP: f64 = 60.0;

/// Shortest arc around the scene, degrees: photographers who stood in one place show one side.
const SHORTEST_ARC: f64 = 20.0;

/// Cameras nearer than this to the previous one are at the same place: in radians, and in distances
/// to the scene.
const SAME_PLACE: f64 = 1e-4;

/// Pieces per camera by which the length of a path is measured.
const PIECES: usize = 50;

/// The arc of the photographers around the scene, degrees in total: a full turn if they went around
/// it, else twice the largest angle from their middle.
pub(super) fn arc(orbit: &Orbit, cameras: &[NamedCamera]) -> f64 {
    let azimuths = cameras.iter().map(|c| orbit.azimuth_of(&c.camera()));
    let mut azimuths: Vec<f64> = azimuths.collect();
    azimuths.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (azimuths.first(), azimuths.last()) else {
        return SHORTEST_ARC;
    };
    let around = 360.0 - (last - first);
    let gaps = azimuths.windows(2).map(|pair| pair[1] - pair[0]);
    if gaps.fold(around, f64::max) < WIDEST_GAP {
        return 360.0;
    }
    let farthest = first.abs().max(last.abs());
    (2.0 * farthest).clamp(SHORTEST_ARC, 330.0)
}

/// Degrees around the scene at a share of the time: uniform for a full turn, otherwise a swing
/// right, left and back that slows down at the turning points. It ends where it begins.
pub(super) fn azimuth(degrees: f64, share: f64) -> f64 {
    if degrees >= 360.0 { 360.0 * share } else { degrees / 2.0 * (TAU * share).sin() }
}

/// `frames` cameras on the path through those of the photographs, at constant speed; `None` if they
/// are all in one place. A distance to the scene counts as a radian, so near objects move about as
/// fast by a step as by a turn.
pub(super) fn through(
    cameras: &[NamedCamera],
    distance: f64,
    frames: usize,
) -> Option<Vec<Camera>> {
    let intrinsics = cameras.first()?.intrinsics;
    let apart = |a: (DVec3, DQuat), b: (DVec3, DQuat)| {
        a.0.distance(b.0) / distance + a.1.angle_between(b.1)
    };
    let mut knots: Vec<(f64, Camera)> = Vec::new();
    for camera in cameras.iter().map(NamedCamera::camera) {
        let time = match knots.last() {
            None => 0.0,
            Some((time, before)) => {
                let step = apart(place(before), place(&camera));
                if step < SAME_PLACE {
                    continue;
                }
                time + step
            }
        };
        knots.push((time, camera));
    }
    let pieces = PIECES * knots.len();
    let spline = Spline::through(knots)?;
    let (begin, end) = spline.ends();
    let time = |piece: usize| begin + (end - begin) * piece as f64 / pieces as f64;
    // The distance to the end of each piece.
    let mut lengths = vec![0.0];
    for piece in 0..pieces {
        let step = apart(spline.at(time(piece)), spline.at(time(piece + 1)));
        lengths.push(lengths[piece] + step);
    }
    let whole = lengths[pieces];
    let frame = |index: usize| {
        let wanted = whole * index as f64 / (frames.max(2) - 1) as f64;
        let piece = lengths.partition_point(|length| *length <= wanted);
        let piece = piece.clamp(1, pieces) - 1;
        let length = lengths[piece + 1] - lengths[piece];
        let within = wanted - lengths[piece];
        let share = if length > 0.0 { (within / length).clamp(0.0, 1.0) } else { 0.0 };
        camera(intrinsics, spline.at(time(piece) * (1.0 - share) + time(piece + 1) * share))
    };
    Some((0..frames).map(frame).collect())
}

/// `frames` cameras on the path through poses, each at its time.
pub(super) fn along(keys: Vec<(f64, Camera)>, frames: usize) -> Option<Vec<Camera>> {
    let intrinsics = keys.first()?.1.intrinsics;
    let spline = Spline::through(keys)?;
    let (begin, end) = spline.ends();
    let time = |index: usize| begin + (end - begin) * index as f64 / (frames.max(2) - 1) as f64;
    let frame = |index| camera(intrinsics, spline.at(time(index)));
    Some((0..frames).map(frame).collect())
}

fn place(camera: &Camera) -> (DVec3, DQuat) {
    (camera.centre(), DQuat::from_mat3(&camera.rotation()))
}

fn camera(intrinsics: Intrinsics, (centre, turn): (DVec3, DQuat)) -> Camera {
    Camera::from_pose(intrinsics, turn, -(turn * centre))
}
