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
/// Windows of [`detail`] along the longer side, each of twice this share of it.
const WINDOWS: usize = 32;
/// Gains between a photograph and its render, beyond which the two do not show the same.
const GAINS: std::ops::RangeInclusive<f64> = 0.2..=5.0;

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
/// count, and neither does a difference in exposure or white balance: each channel's gain and
/// offset are solved for with the motion, or it would be taken for one. `None` if the images do not
/// determine the motion.
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
    let [photograph, render] = &[photograph, render].map(|image| detail(image, kept));
    let probed = &probed.each_ref().map(|image| detail(image, kept));
    let exposure = Exposure::between(render, photograph, kept);
    let bend = BEND * middle_difference(photograph, render, &exposure, kept)?;
    let mut curvature = [[0.0_f64; 6]; 6];
    let mut slope = [0.0_f64; 6];
    for channel in 0..3 {
        // The motion, then the channel's gain and offset.
        let mut all = Normal::<8>::default();
        for y in BORDER..height - BORDER {
            let from = (channel * height + y) * width;
            let mut row = Normal::<8, f32>::default();
            for at in from + BORDER..from + width - BORDER {
                if kept.is_some_and(|kept| !kept.holds(at - from, y)) {
                    continue;
                }
                let now = render.data()[at];
                let missing = photograph.data()[at] - exposure.of(channel, now);
                let weight = if missing.abs() <= bend { 1.0 } else { bend / missing.abs() };
                let gain = exposure.gain(channel);
                let by: [f32; 8] = std::array::from_fn(|i| match i {
                    6 => now,
                    7 => 1.0,
                    probe => gain * (probed[probe].data()[at] - now),
                });
                row.add(&by, missing, weight);
            }
            all.sum(&row);
        }
        let (lower, right) = all.without_last_two();
        for i in 0..6 {
            slope[i] += right[i];
            (0..=i).for_each(|j| curvature[i][j] += lower[i][j]);
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

/// The image without structures larger than a window: light that differs from photograph to
/// photograph (a shadow, a reflection, a tone mapped locally) is smooth, and moves no edge. Pixels
/// that are not `kept` are left out of the means.
fn detail(image: &Image, kept: Option<&Mask>) -> Image {
    let (width, height) = (image.width(), image.height());
    let reach = (width.max(height) / WINDOWS).max(BORDER);
    let windowed = |values: &[f32]| {
        let rows = means(values, width, height, reach);
        means(&rows, height, width, reach)
    };
    let shares: Option<Vec<f32>> =
        kept.map(|kept| kept.pixels().iter().map(|kept| f32::from(u8::from(*kept))).collect());
    let of_kept = shares.as_ref().map(|shares| windowed(shares));
    let mut detail = image.clone();
    for channel in 0..3 {
        let means = match (&shares, &of_kept) {
            (Some(shares), Some(of_kept)) => {
                let plane = image.plane(channel).iter().zip(shares);
                let counted: Vec<f32> = plane.map(|(value, share)| value * share).collect();
                let means = windowed(&counted);
                means.iter().zip(of_kept).map(|(mean, share)| mean / share.max(1e-6)).collect()
            }
            _ => windowed(image.plane(channel)),
        };
        let values = detail.plane_mut(channel).iter_mut().zip(&means);
        values.for_each(|(value, mean)| *value -= mean);
    }
    detail
}

/// The mean of the window around each value along its row, transposed.
fn means(values: &[f32], width: usize, height: usize, reach: usize) -> Vec<f32> {
    let mut means = vec![0.0; values.len()];
    let mut sums = vec![0.0_f64; width + 1];
    for (y, row) in values.chunks_exact(width.max(1)).enumerate() {
        for (x, value) in row.iter().enumerate() {
            sums[x + 1] = sums[x] + f64::from(*value);
        }
        for x in 0..width {
            let (from, to) = (x.saturating_sub(reach), (x + reach + 1).min(width));
            means[x * height + y] = ((sums[to] - sums[from]) / (to - from) as f64) as f32;
        }
    }
    means
}

/// Normal equations of weighted least squares: the lower half of the matrix, and the right side.
struct Normal<const N: usize, T = f64> {
    lower: [[T; N]; N],
    right: [T; N],
}

impl<const N: usize, T: Copy + Default> Default for Normal<N, T> {
    fn default() -> Self {
        Self { lower: [[T::default(); N]; N], right: [T::default(); N] }
    }
}

impl<const N: usize> Normal<N, f32> {
    fn add(&mut self, by: &[f32; N], missing: f32, weight: f32) {
        for i in 0..N {
            self.right[i] += weight * by[i] * missing;
            for j in 0..=i {
                self.lower[i][j] += weight * by[i] * by[j];
            }
        }
    }
}

impl<const N: usize> Normal<N> {
    fn sum(&mut self, row: &Normal<N, f32>) {
        for i in 0..N {
            self.right[i] += f64::from(row.right[i]);
            for j in 0..=i {
                self.lower[i][j] += f64::from(row.lower[i][j]);
            }
        }
    }

    /// The equations of the other unknowns after the last two are solved for.
    fn without_last_two(mut self) -> ([[f64; N]; N], [f64; N]) {
        for last in (N - 2..N).rev() {
            let pivot = self.lower[last][last];
            if pivot <= f64::MIN_POSITIVE {
                continue;
            }
            let row = self.lower[last];
            for i in 0..last {
                let share = row[i] / pivot;
                self.right[i] -= share * self.right[last];
                (0..=i).for_each(|j| self.lower[i][j] -= share * row[j]);
            }
        }
        (self.lower, self.right)
    }
}

/// The gain and offset of each channel from one image to another of the same view, in values.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Exposure {
    channels: [[f32; 2]; 3],
}

impl Exposure {
    /// By least squares over the pixels that count.
    fn between(from: &Image, to: &Image, kept: Option<&Mask>) -> Self {
        let mut sums = [[0.0_f64; 5]; 3];
        let height = from.height().max(1);
        let inside = height.saturating_sub(2 * BORDER).max(1);
        for (at, (a, b)) in rows_within(from, kept).zip(rows_within(to, kept)).enumerate() {
            for (&x, &y) in a.iter().zip(&*b) {
                let (x, y) = (f64::from(x), f64::from(y));
                let terms = [1.0, x, y, x * x, x * y];
                sums[(at / inside).min(2)].iter_mut().zip(terms).for_each(|(sum, v)| *sum += v);
            }
        }
        let fit = |[n, x, y, xx, xy]: [f64; 5]| {
            let spread = n * xx - x * x;
            let gain = if spread > 1e-9 * n * n { (n * xy - x * y) / spread } else { 1.0 };
            // Images of different views are as they are.
            let gain = if GAINS.contains(&gain) { gain } else { 1.0 };
            [gain as f32, ((y - gain * x) / n.max(1.0)) as f32]
        };
        Self { channels: sums.map(fit) }
    }

    fn gain(&self, channel: usize) -> f32 {
        self.channels[channel][0]
    }

    fn of(&self, channel: usize, value: f32) -> f32 {
        let [gain, offset] = self.channels[channel];
        gain * value + offset
    }
}

/// The mean absolute difference of a photograph and its render in the photograph's exposure,
/// without the border and pixels that are not `kept`.
pub fn difference(photograph: &Image, render: &Image, kept: Option<&Mask>) -> f64 {
    let [photograph, render] = &[photograph, render].map(|image| detail(image, kept));
    let exposure = Exposure::between(render, photograph, kept);
    let (mut sum, mut count) = (0.0, 0);
    differences(photograph, render, &exposure, kept, |difference| {
        sum += f64::from(difference);
        count += 1;
    });
    sum / f64::from(count.max(1_u32))
}

/// Standard deviation of the differences, estimated from the median of every seventh; `None` if it
/// is 0 or not finite.
fn middle_difference(
    photograph: &Image,
    render: &Image,
    exposure: &Exposure,
    kept: Option<&Mask>,
) -> Option<f32> {
    let (mut some, mut at) = (Vec::new(), 0_usize);
    differences(photograph, render, exposure, kept, |difference| {
        if at.is_multiple_of(7) {
            some.push(difference);
        }
        at += 1;
    });
    if some.is_empty() {
        return None;
    }
    let middle = some.len() / 2;
    let (_, median, _) = some.select_nth_unstable_by(middle, f32::total_cmp);
    let deviation = 1.4826 * *median;
    (deviation.is_finite() && deviation > 0.0).then_some(deviation)
}

/// Passes the absolute difference of every value that counts to a callback.
fn differences(
    photograph: &Image,
    render: &Image,
    exposure: &Exposure,
    kept: Option<&Mask>,
    mut receive: impl FnMut(f32),
) {
    let inside = photograph.height().saturating_sub(2 * BORDER).max(1);
    let rows = rows_within(photograph, kept).zip(rows_within(render, kept));
    for (at, (seen, rendered)) in rows.enumerate() {
        let channel = (at / inside).min(2);
        for (seen, rendered) in seen.iter().zip(&*rendered) {
            receive((seen - exposure.of(channel, *rendered)).abs());
        }
    }
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
