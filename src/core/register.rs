//! Camera registration: the camera of a photograph, corrected by renders of the scene. Gauss-Newton
//! over the six degrees of freedom of a camera, with derivatives from renders of slightly moved
//! cameras.
//!
//! Differs from the paper, which keeps COLMAP's poses. Features of dark, shaken photographs locate
//! a camera to about a third of a pixel; the scene is then the mean of views that do not quite
//! agree, and no sharper.

use std::borrow::Cow;

use glam::{DMat3, DMat4, DQuat, DVec3};

use crate::camera::Camera;
use crate::image::Image;
use crate::linear::solve;
use crate::mask::Mask;

/// Distance by which a probe moves the image, px.
const PROBE_PX: f64 = 0.25;
/// Largest correction, px: the images change linearly only over short distances.
const LARGEST_PX: f64 = 1.0;
/// Width of the excluded border, px: shake moves light from beyond it into the image.
const BORDER: usize = 4;
/// Number of deviations from which differences count linearly instead of by their square (Huber).
const BEND: f32 = 2.0;
/// Levenberg's damping as a share of the mean curvature: rotation and translation to the left look
/// alike where the scene is flat, and must not grow to cancel each other.
const DAMPING: f64 = 1e-3;

/// The motion of a camera in its own axes: a rotation vector (rad), then a shift (world units).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Rotation vector x y z, rad, then the shift x y z, world units.
    pub twist: [f32; 6],
}

impl Motion {
    /// The camera after the motion.
    pub fn moved(&self, camera: &Camera) -> Camera {
        let [a, b, c, x, y, z] = self.twist.map(f64::from);
        let turn = DQuat::from_scaled_axis(DVec3::new(a, b, c));
        let motion = DMat4::from_rotation_translation(turn, DVec3::new(x, y, z));
        Camera { world_to_camera: motion * camera.world_to_camera, ..*camera }
    }

    /// The sum of this motion and a further small one; motions are small enough to add.
    #[must_use]
    pub fn plus(&self, by: &[f64; 6]) -> Self {
        Self { twist: std::array::from_fn(|i| self.twist[i] + by[i] as f32) }
    }
}

/// Six small motions, each of which moves the image of a scene at the median `depth` (world units)
/// by about a quarter of a pixel; at the border if it does not move the middle.
pub fn probes(camera: &Camera, depth: f64) -> [[f64; 6]; 6] {
    let k = &camera.intrinsics;
    let turn = PROBE_PX / k.fx;
    let roll = PROBE_PX / (0.25 * k.width.max(k.height) as f64);
    let sizes = [turn, turn, roll, turn * depth, turn * depth, roll * depth];
    std::array::from_fn(|axis| std::array::from_fn(|i| if i == axis { sizes[axis] } else { 0.0 }))
}

/// The motion that aligns `render` with `photograph` to first order, given `probed`, the renders
/// after each of the camera's [`probes`]. All have one size. Pixels that are not `kept` do not
/// count. `None` if the images do not determine it.
pub fn correction(
    photograph: &Image,
    render: &Image,
    probed: &[Image; 6],
    probes: &[[f64; 6]; 6],
    kept: Option<&Mask>,
) -> Option<[f64; 6]> {
    let (width, height) = (render.width(), render.height());
    if width.min(height) <= 4 * BORDER {
        return None;
    }
    let bend = BEND * middle_difference(photograph, render, kept)?;
    let mut curvature = [[0.0_f64; 6]; 6];
    let mut slope = [0.0_f64; 6];
    for channel in 0..3 {
        for y in BORDER..height - BORDER {
            let from = (channel * height + y) * width;
            let (mut row_curvature, mut row_slope) = ([[0.0_f32; 6]; 6], [0.0_f32; 6]);
            for at in from + BORDER..from + width - BORDER {
                if kept.is_some_and(|kept| !kept.holds(at - from, y)) {
                    continue;
                }
                let now = render.data()[at];
                let missing = photograph.data()[at] - now;
                let weight = if missing.abs() <= bend { 1.0 } else { bend / missing.abs() };
                let by: [f32; 6] = std::array::from_fn(|i| probed[i].data()[at] - now);
                for i in 0..6 {
                    row_slope[i] += weight * by[i] * missing;
                    for j in 0..=i {
                        row_curvature[i][j] += weight * by[i] * by[j];
                    }
                }
            }
            for i in 0..6 {
                slope[i] += f64::from(row_slope[i]);
                for j in 0..=i {
                    curvature[i][j] += f64::from(row_curvature[i][j]);
                }
            }
        }
    }
    let mean = (0..6).map(|i| curvature[i][i]).sum::<f64>() / 6.0;
    (0..6).for_each(|i| curvature[i][i] += DAMPING * mean);
    let shares = solve(curvature, slope)?;
    let longest = shares.iter().fold(0.0_f64, |most, share| most.max(share.abs())) * PROBE_PX;
    let kept = (LARGEST_PX / longest.max(1e-12)).min(1.0);
    Some(std::array::from_fn(|i| {
        kept * (0..6).map(|axis| shares[axis] * probes[axis][i]).sum::<f64>()
    }))
}

/// The mean absolute difference of two images without the border and pixels that are not `kept`.
pub fn difference(photograph: &Image, render: &Image, kept: Option<&Mask>) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (a, b) in rows_within(photograph, kept).zip(rows_within(render, kept)) {
        sum = a.iter().zip(&*b).fold(sum, |sum, (a, b)| sum + f64::from((a - b).abs()));
        count += a.len();
    }
    sum / count.max(1) as f64
}

/// Standard deviation of the differences, estimated from the median of every seventh; `None` if it
/// is 0 or not finite.
fn middle_difference(photograph: &Image, render: &Image, kept: Option<&Mask>) -> Option<f32> {
    let rows = rows_within(photograph, kept).zip(rows_within(render, kept));
    let apart = |(a, b): (Cow<'_, [f32]>, Cow<'_, [f32]>)| -> Vec<f32> {
        a.iter().zip(&*b).map(|(a, b)| (a - b).abs()).collect()
    };
    let mut some: Vec<f32> = rows.flat_map(apart).step_by(7).collect();
    if some.is_empty() {
        return None;
    }
    let middle = some.len() / 2;
    let (_, median, _) = some.select_nth_unstable_by(middle, f32::total_cmp);
    let deviation = 1.4826 * *median;
    (deviation.is_finite() && deviation > 0.0).then_some(deviation)
}

/// The rows of all channels within the border, without pixels that are not `kept`.
fn rows_within<'a>(
    image: &'a Image,
    kept: Option<&'a Mask>,
) -> impl Iterator<Item = Cow<'a, [f32]>> {
    let (width, height) = (image.width(), image.height());
    let rows = image.data().chunks_exact(width.max(1)).enumerate();
    let inside = move |y: usize| (BORDER..height.saturating_sub(BORDER)).contains(&y);
    rows.filter(move |(row, _)| inside(row % height)).map(move |(at, row)| {
        let row = row.get(BORDER..width.saturating_sub(BORDER)).unwrap_or(&[]);
        let Some(kept) = kept else {
            return row.into();
        };
        let holds = |x: &usize| kept.holds(x + BORDER, at % height);
        (0..row.len()).filter(holds).map(|x| row[x]).collect()
    })
}

/// Removes from `motions` the part common to all cameras: a rotation, a translation and a scale of
/// the whole world. No image determines it, and along it cameras and scene would drift away from
/// the given poses.
pub fn hold_gauge(cameras: &[Camera], motions: &mut [Motion]) {
    let centre = cameras.iter().map(Camera::centre).sum::<DVec3>() / cameras.len().max(1) as f64;
    let radius = cameras.iter().map(|c| c.centre().distance(centre)).fold(0.0, f64::max);
    if radius <= 0.0 {
        return;
    }
    // Unknowns: rotation, translation / radius, scale. A camera's rotation constrains the first,
    // its centre all of them.
    let (mut lower, mut right) = ([[0.0; 7]; 7], [0.0; 7]);
    for (camera, motion) in cameras.iter().zip(motions.iter()) {
        let (turned, displaced) = world_motion(camera, &motion.moved(camera));
        let arm = (camera.centre() - centre) / radius;
        for axis in 0..3 {
            let mut row = [0.0; 7];
            row[axis] = 1.0;
            add_row(&mut lower, &mut right, row, turned[axis]);
            let unit = DVec3::AXES[axis];
            let mut row = [0.0; 7];
            // (turn x arm) along the axis = turn . (arm x axis).
            row[..3].copy_from_slice(&arm.cross(unit).to_array());
            row[3 + axis] = 1.0;
            row[6] = arm[axis];
            add_row(&mut lower, &mut right, row, displaced[axis] / radius);
        }
    }
    (0..7).for_each(|i| lower[i][i] += 1e-9);
    let Some(common) = solve(lower, right) else {
        return;
    };
    let turn = DVec3::new(common[0], common[1], common[2]);
    let shift = DVec3::new(common[3], common[4], common[5]);
    for (camera, motion) in cameras.iter().zip(motions.iter_mut()) {
        let arm = (camera.centre() - centre) / radius;
        let displaced = radius * (turn.cross(arm) + shift + common[6] * arm);
        let back = camera_motion(camera, turn, displaced);
        *motion = motion.plus(&back.map(|x| -x));
    }
}

fn add_row(lower: &mut [[f64; 7]; 7], right: &mut [f64; 7], row: [f64; 7], value: f64) {
    for i in 0..7 {
        right[i] += row[i] * value;
        for j in 0..=i {
            lower[i][j] += row[i] * row[j];
        }
    }
}

/// A camera's motion in the world: its rotation vector and the displacement of its centre.
fn world_motion(before: &Camera, after: &Camera) -> (DVec3, DVec3) {
    // Axes of the camera as columns; the rotation from the old to the new ones.
    let turn: DMat3 = after.rotation().transpose() * before.rotation();
    (DQuat::from_mat3(&turn).to_scaled_axis(), after.centre() - before.centre())
}

/// The twist of a small motion given in the world: the inverse of [`world_motion`], to first order.
fn camera_motion(camera: &Camera, turned: DVec3, displaced: DVec3) -> [f64; 6] {
    let rotation = camera.rotation();
    let turn = -(rotation * turned);
    // The centre is -R't; moving it by d moves t by -R d.
    let shift = -(rotation * displaced);
    [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
}

#[cfg(test)]
mod tests;
