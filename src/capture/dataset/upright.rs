//! Transforms given poses from the pixels of their computation to the upright photograph.

use glam::DMat4;

use super::given_view::GivenView;
use crate::image::Header;
use crate::poses::Lens;
use crate::poses::turn::Turn;

/// Largest relative difference in proportions of a photograph and its camera, beyond rounding in a
/// resize: less moves no pixel at a working size by one.
const OTHER_SHAPE: f64 = 0.005;

/// A given view in pixels of the upright photograph.
pub(super) struct Upright {
    pub(super) lens: Lens,
    /// Of a left-handed camera if the rotation mirrors.
    pub(super) world_to_camera: DMat4,
    /// The rotation of the stored pixels, for which the pose was given.
    pub(super) turn: Turn,
    /// Whether the sizes alone do not prove that the pose is for the stored pixels.
    pub(super) is_assumed: bool,
}

/// The view in pixels of the photograph, whose size may differ from the size for which the pose was
/// computed. Poses are for the stored pixels, as in COLMAP, which ignores orientation, unless their
/// size matches only the upright picture.
///
/// # Errors
/// Why the pose does not fit this photograph.
pub(super) fn upright(given: &GivenView, header: &Header) -> Result<Upright, String> {
    let turn = Turn::upright(header.orientation);
    let size = (header.width, header.height);
    let stored = turn.size(size);
    let of = |size| given.lens.size().is_none_or(|given| is_of_shape(given, size));
    let ahead = |width, height| given.lens.at(width, height);
    if of(stored) {
        return Ok(Upright {
            lens: turn.lens(&ahead(stored.0, stored.1)),
            world_to_camera: turn.of_camera() * given.world_to_camera,
            turn,
            is_assumed: !turn.is_none() && of(size),
        });
    }
    if of(size) {
        return Ok(Upright {
            lens: ahead(size.0, size.1),
            world_to_camera: given.world_to_camera,
            turn: Turn::upright(crate::image::Orientation::NoTransforms),
            is_assumed: false,
        });
    }
    let (width, height) = given.lens.size().unwrap_or(stored);
    let turned = match turn.swaps_sides() {
        true => format!(", turned upright by EXIF {} x {}", size.0, size.1),
        false => String::new(),
    };
    let cause = match is_of_shape((height, width), stored) {
        true => "turned by a quarter",
        false => "cropped or squeezed",
    };
    Err(format!(
        "the pose is of a picture of {width} x {height} px, but the photograph has {} x {} \
         px{turned}: it was {cause} after the poses were computed; give the photographs that they \
         were computed on",
        stored.0, stored.1
    ))
}

/// Whether one is the other resized, up to rounding of the smaller one's sides.
fn is_of_shape(given: (usize, usize), photograph: (usize, usize)) -> bool {
    let (w, h) = (given.0 as f64, given.1 as f64);
    let (width, height) = (photograph.0 as f64, photograph.1 as f64);
    let rounding = 1.0 / w.min(h).min(width).min(height);
    ((w * height) / (h * width)).ln().abs() <= OTHER_SHAPE.max(rounding)
}
