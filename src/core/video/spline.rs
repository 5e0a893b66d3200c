//! A smooth curve through poses.

use glam::{DQuat, DVec3};

use crate::camera::Camera;

/// Numbers of a pose: centre, then the rotation as x, y, z, w.
const NUMBERS: usize = 7;

/// A Catmull-Rom cubic through poses, each at its own time: it passes through every pose, with
/// continuous velocity and rotation.
pub(super) struct Spline {
    knots: Vec<(f64, [f64; NUMBERS])>,
}

impl Spline {
    /// Through cameras at increasing times; `None` for fewer than two.
    pub(super) fn through(cameras: impl IntoIterator<Item = (f64, Camera)>) -> Option<Self> {
        let mut knots: Vec<(f64, [f64; NUMBERS])> = Vec::new();
        for (time, camera) in cameras {
            let mut turn = DQuat::from_mat3(&camera.rotation());
            // A rotation equals its negative: the nearer one is the shorter way.
            if let Some((_, before)) = knots.last() {
                let before = DQuat::from_slice(&before[3..]);
                if before.dot(turn) < 0.0 {
                    turn = -turn;
                }
            }
            let centre = camera.centre();
            let pose = [centre.x, centre.y, centre.z, turn.x, turn.y, turn.z, turn.w];
            knots.push((time, pose));
        }
        (knots.len() >= 2).then_some(Self { knots })
    }

    /// First and last time.
    pub(super) fn ends(&self) -> (f64, f64) {
        let last = self.knots.len() - 1;
        (self.knots[0].0, self.knots[last].0)
    }

    /// Centre and rotation (world to camera) at a time.
    pub(super) fn at(&self, time: f64) -> (DVec3, DQuat) {
        let before = self.knots.partition_point(|(knot, _)| *knot <= time);
        let index = before.clamp(1, self.knots.len() - 1) - 1;
        let ((t0, from), (t1, to)) = (self.knots[index], self.knots[index + 1]);
        let length = t1 - t0;
        let s = ((time - t0) / length).clamp(0.0, 1.0);
        let (leaving, arriving) = (self.tangent(index), self.tangent(index + 1));
        let (s2, s3) = (s * s, s * s * s);
        let number = |i: usize| {
            from[i] * (2.0 * s3 - 3.0 * s2 + 1.0)
                + to[i] * (3.0 * s2 - 2.0 * s3)
                + length * (leaving[i] * (s3 - 2.0 * s2 + s) + arriving[i] * (s3 - s2))
        };
        let pose: [f64; NUMBERS] = std::array::from_fn(number);
        let turn = DQuat::from_slice(&pose[3..]).normalize();
        (DVec3::from_slice(&pose[..3]), turn)
    }

    /// The derivative of each number at a knot.
    fn tangent(&self, index: usize) -> [f64; NUMBERS] {
        let (t0, from) = self.knots[index.saturating_sub(1)];
        let (t1, to) = self.knots[(index + 1).min(self.knots.len() - 1)];
        std::array::from_fn(|i| (to[i] - from[i]) / (t1 - t0))
    }
}
