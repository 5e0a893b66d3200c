//! What every format tells of one view.

use crate::camera::Intrinsics;
use crate::poses::{Distortion, Lens};

/// The lens of a view, as a format gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum GivenLens {
    /// Of pictures of its own size.
    Sized(Lens),
    /// Of pictures whose size is not told: the photographs themselves.
    OfPhotograph {
        focal: Focal,
        /// Pixels; the middle where it is not told.
        centre: [Option<f64>; 2],
        distortion: Distortion,
    },
}

/// A focal length without the size of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Focal {
    /// To the right and down.
    Pixels([f64; 2]),
    /// How wide and how high the picture is, radians; pixels are square where one is not told.
    Angles([Option<f64>; 2]),
}

impl GivenLens {
    /// The size of its pictures, px, where it is told.
    pub(super) fn size(&self) -> Option<(usize, usize)> {
        match self {
            Self::Sized(lens) => Some((lens.intrinsics.width, lens.intrinsics.height)),
            Self::OfPhotograph { .. } => None,
        }
    }

    /// The lens of a photograph of this size, pixels.
    pub(super) fn at(&self, width: usize, height: usize) -> Lens {
        match *self {
            Self::Sized(lens) => {
                Lens { intrinsics: lens.intrinsics.resized(width, height), ..lens }
            }
            Self::OfPhotograph { focal, centre: [cx, cy], distortion } => {
                let [fx, fy] = match focal {
                    Focal::Pixels(both) => both,
                    Focal::Angles([x, y]) => {
                        let focal =
                            |side: usize, angle: f64| 0.5 * side as f64 / (0.5 * angle).tan();
                        let fx = x.map(|angle| focal(width, angle));
                        let fy = y.map(|angle| focal(height, angle));
                        [fx.or(fy).unwrap_or_default(), fy.or(fx).unwrap_or_default()]
                    }
                };
                let intrinsics = Intrinsics {
                    width,
                    height,
                    fx,
                    fy,
                    cx: cx.unwrap_or(0.5 * width as f64),
                    cy: cy.unwrap_or(0.5 * height as f64),
                };
                Lens { intrinsics, distortion }
            }
        }
    }
}

impl From<Lens> for GivenLens {
    fn from(lens: Lens) -> Self {
        Self::Sized(lens)
    }
}

/// A pose with the lens it was given with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GivenView {
    pub(super) lens: GivenLens,
    pub(super) world_to_camera: glam::DMat4,
    /// Nearest and farthest depth, where the format tells.
    pub(super) bounds: Option<(f64, f64)>,
    /// Whether the format keeps it from training.
    pub(super) held_out: bool,
}
