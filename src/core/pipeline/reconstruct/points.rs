//! The sparse points that initialise the first round.

use crate::camera::Split;
use crate::image::Image;
use crate::mask::Mask;
use crate::pipeline::views::View;
use crate::poses::{Poses, SparsePoint};
use crate::reconstruct::Point;

/// The sparse points in the colours of the round's images: the median over the training views that
/// show a point. COLMAP's own colours are those of brightened copies; splats that start much too
/// bright turn transparent before they turn dark, and leave holes.
pub fn coloured(poses: &Poses, views: &[View], images: &[Image]) -> Vec<Point> {
    let seen = |position: [f64; 3]| -> Vec<[f32; 3]> {
        views
            .iter()
            .zip(images)
            .filter(|(view, _)| view.split == Split::Train)
            .filter_map(|(view, image)| {
                let (pixel, _) = view.camera.shows(position.into())?;
                let hides = |mask: &Mask| !mask.holds(pixel.x as usize, pixel.y as usize);
                if view.mask.as_ref().is_some_and(hides) {
                    return None;
                }
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
        .map(|point| Point { position: point.position.map(|x| x as f32), colour: colour(point) })
        .collect()
}

/// Positions and colours of the sparse points, unchanged.
pub fn as_given(poses: &Poses) -> Vec<Point> {
    poses
        .points
        .iter()
        .map(|point| Point { position: point.position.map(|x| x as f32), colour: point.colour })
        .collect()
}
