//! The sparse points that a first round grows from.

use crate::camera::Split;
use crate::cancel::{CancelToken, Cancelled};
use crate::image::Image;
use crate::pipeline::views::View;
use crate::poses::{Poses, SparsePoint};
use crate::reconstruct::Point;
use crate::stereo::{DensePoint, Stereo};

/// The sparse points in the colours that the round trains on: the median over the training views
/// that a point falls into. COLMAP's own colours are those of its brightened copies; splats that
/// start much too bright turn transparent before they turn dark, and holes stay.
pub fn coloured(poses: &Poses, views: &[View], images: &[Image]) -> Vec<Point> {
    let seen = |position: [f64; 3]| -> Vec<[f32; 3]> {
        views
            .iter()
            .zip(images)
            .filter(|(view, _)| view.split == Split::Train)
            .filter_map(|(view, image)| {
                let (pixel, _) = view.camera.shows(position.into())?;
                Some(image.get(pixel.x as usize, pixel.y as usize))
            })
            .collect()
    };
    let colour = |point: &SparsePoint| {
        let seen = seen(point.position);
        if seen.is_empty() {
            return point.colour;
        }
        std::array::from_fn(|channel| {
            let mut values: Vec<f32> = seen.iter().map(|rgb| rgb[channel]).collect();
            values.sort_by(f32::total_cmp);
            (values[values.len() / 2].clamp(0.0, 1.0) * 255.0).round() as u8
        })
    };
    poses
        .points
        .iter()
        .map(|point| Point {
            position: point.position.map(|x| x as f32),
            colour: colour(point),
        })
        .collect()
}

/// Share of the cap up to which dense points are added to the sparse ones: the rest is for what
/// neither show, and goes to where training finds the largest errors.
const FILLED_SHARE: f64 = 0.6;

/// What the training views agree on about depth.
///
/// # Errors
/// Cancelled.
pub fn stereo(
    poses: &Poses,
    views: &[View],
    images: &[Image],
    cancel: &CancelToken,
) -> Result<Stereo, Cancelled> {
    let training = views
        .iter()
        .zip(images)
        .filter(|(view, _)| view.split == Split::Train)
        .map(|(view, image)| (view.camera, image));
    let training: Vec<_> = training.collect();
    let sparse = as_given(poses);
    let sparse: Vec<[f32; 3]> = sparse.iter().map(|point| point.position).collect();
    // No view saw a guessed point.
    let measured = poses.points.iter().any(|point| point.track > 0);
    Stereo::of(&training, &sparse, measured, cancel)
}

/// As many dense points as fit beside `sparse` ones below the cap.
pub fn dense(stereo: &Stereo, sparse: usize, cap: usize) -> Vec<Point> {
    let most = ((FILLED_SHARE * cap as f64) as usize).saturating_sub(sparse);
    let level = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    let point = |point: DensePoint| Point {
        position: point.position,
        colour: point.colour.map(level),
    };
    stereo.points(most).into_iter().map(point).collect()
}

/// Positions and colours of the sparse points, as the trainer takes them.
pub fn as_given(poses: &Poses) -> Vec<Point> {
    poses
        .points
        .iter()
        .map(|point| Point {
            position: point.position.map(|x| x as f32),
            colour: point.colour,
        })
        .collect()
}
