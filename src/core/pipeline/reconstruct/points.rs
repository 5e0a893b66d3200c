//! The sparse points that a first round grows from.

use crate::camera::Split;
use crate::image::Image;
use crate::pipeline::views::View;
use crate::poses::{Poses, SparsePoint};
use crate::reconstruct::Point;

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
