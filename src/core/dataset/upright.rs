//! Given poses and the pixels that they were computed on, brought to the upright photograph.

use glam::DMat4;

use super::given_view::GivenView;
use crate::image::Header;
use crate::poses::Lens;
use crate::poses::turn::Turn;

/// By how much the sides of a photograph may differ from those of its camera in proportion, beside
/// the rounding of a resize: less moves no pixel of a working size by one.
const OTHER_SHAPE: f64 = 0.005;

/// A given view in the upright photograph's pixels.
pub(super) struct Upright {
    pub(super) lens: Lens,
    /// Of a left-handed camera where the turn mirrors.
    pub(super) world_to_camera: DMat4,
    /// What was done to the stored pixels, for which the pose was given.
    pub(super) turn: Turn,
    /// Whether the sizes alone do not tell that the pose is one of the stored pixels.
    pub(super) is_assumed: bool,
}

/// The view in the pixels of the photograph, whose size may differ from the one that the pose was
/// computed at. Poses are those of the stored pixels, as COLMAP, which knows no orientation, has
/// them, unless their size is that of the upright picture alone.
///
/// # Errors
/// Why the pose is not one of this photograph.
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

/// Whether one is the other resized, but for the rounding of the smaller one's sides.
fn is_of_shape(given: (usize, usize), photograph: (usize, usize)) -> bool {
    let (w, h) = (given.0 as f64, given.1 as f64);
    let (width, height) = (photograph.0 as f64, photograph.1 as f64);
    let rounding = 1.0 / w.min(h).min(width).min(height);
    ((w * height) / (h * width)).ln().abs() <= OTHER_SHAPE.max(rounding)
}
