//! The sparse points that initialise the first round.

use crate::camera::Camera;
use crate::image::Image;
use crate::mask::Mask;
use crate::poses::{Poses, SparsePoint};
use crate::reconstruct::Point;

/// A picture of the sparse points: its camera, values and the pixels that count.
pub type Seen<'a> = (&'a Camera, &'a Image, Option<&'a Mask>);

/// The sparse points in the colours of the round's images: the median over the training views that
/// show a point. COLMAP's own colours are those of brightened copies; splats that start much too
/// bright turn transparent before they turn dark, and leave holes.
pub fn coloured<'a>(poses: &Poses, pictures: impl Iterator<Item = Seen<'a>>) -> Vec<Point> {
    let pictures: Vec<Seen<'_>> = pictures.collect();
    let seen = |position: [f64; 3]| -> Vec<[f32; 3]> {
        let of = |(camera, image, mask): &Seen<'_>| {
            let (pixel, _) = camera.shows(position.into())?;
            let (x, y) = (pixel.x as usize, pixel.y as usize);
            mask.is_none_or(|mask| mask.holds(x, y)).then(|| image.get(x, y))
        };
        pictures.iter().filter_map(of).collect()
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
