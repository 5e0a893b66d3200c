//! The common contents of a view in all formats.

use crate::camera::Intrinsics;
use crate::poses::{Distortion, Lens};

/// The lens of a view, as a format gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum GivenLens {
    /// For pictures with their own size.
    Sized(Lens),
    /// For pictures without a given size: the photographs themselves.
    OfPhotograph {
        focal: Focal,
        /// Pixels; the centre if not given.
        centre: [Option<f64>; 2],
        distortion: Distortion,
    },
}

/// A focal length without a picture size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Focal {
    /// Horizontal and vertical.
    Pixels([f64; 2]),
    /// Horizontal and vertical field of view, radians; pixels are square if one is not given.
    Angles([Option<f64>; 2]),
}

impl GivenLens {
    /// The size of its pictures, px, if given.
    pub(super) fn size(&self) -> Option<(usize, usize)> {
        match self {
            Self::Sized(lens) => Some((lens.intrinsics.width, lens.intrinsics.height)),
            Self::OfPhotograph { .. } => None,
        }
    }

    /// The lens for a photograph of this size, pixels.
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

/// A pose with its given lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GivenView {
    pub(super) lens: GivenLens,
    pub(super) world_to_camera: glam::DMat4,
    /// Nearest and farthest depth, if the format has them.
    pub(super) bounds: Option<(f64, f64)>,
    /// Whether the format holds it out from training.
    pub(super) held_out: bool,
}
