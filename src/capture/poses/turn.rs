//! Cameras and lenses of a picture that is rotated upright.

use glam::{DMat2, DMat4, DVec2, DVec3, DVec4};

use super::{Distortion, Lens};
use crate::camera::Intrinsics;
use crate::image::Orientation;

/// The effect of an orientation on directions in the picture: a rotation by quarter turns, possibly
/// mirrored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn(DMat2);

impl Turn {
    /// From the stored picture to the upright one.
    pub fn upright(orientation: Orientation) -> Self {
        let (right, down) = (DVec2::X, DVec2::Y);
        // The directions of the stored picture's right and down in the upright one.
        let (x, y) = match orientation {
            Orientation::NoTransforms => (right, down),
            Orientation::FlipHorizontal => (-right, down),
            Orientation::Rotate180 => (-right, -down),
            Orientation::FlipVertical => (right, -down),
            Orientation::Rotate90FlipH => (down, right),
            Orientation::Rotate90 => (down, -right),
            Orientation::Rotate270FlipH => (-down, -right),
            Orientation::Rotate270 => (-down, right),
        };
        Self(DMat2::from_cols(x, y))
    }

    /// Whether it changes nothing.
    pub fn is_none(self) -> bool {
        self.0 == DMat2::IDENTITY
    }

    /// Whether width and height are swapped.
    pub fn swaps_sides(self) -> bool {
        self.0.x_axis.x == 0.0
    }

    /// Whether left and right are swapped: no camera takes such a picture of the same world.
    pub fn is_mirrored(self) -> bool {
        self.0.determinant() < 0.0
    }

    /// The size of a picture after the turn, and also before it, as a turn either swaps the sides
    /// or not.
    pub fn size(self, (width, height): (usize, usize)) -> (usize, usize) {
        match self.swaps_sides() {
            true => (height, width),
            false => (width, height),
        }
    }

    /// The turn in camera space, applied after the transform from world to camera.
    pub fn of_camera(self) -> DMat4 {
        let axis = |v: DVec2| DVec4::new(v.x, v.y, 0.0, 0.0);
        DMat4::from_cols(axis(self.0.x_axis), axis(self.0.y_axis), DVec4::Z, DVec4::W)
    }

    /// The lens of the rotated picture.
    pub fn lens(self, lens: &Lens) -> Lens {
        let k = &lens.intrinsics;
        let (width, height) = self.size((k.width, k.height));
        let size = DVec2::new(k.width as f64, k.height as f64);
        // Relative to the centre a point rotates like a direction.
        let turned = self.0 * (DVec2::new(k.cx, k.cy) - 0.5 * size);
        let centre = turned + 0.5 * DVec2::new(width as f64, height as f64);
        let (fx, fy) = match self.swaps_sides() {
            true => (k.fy, k.fx),
            false => (k.fx, k.fy),
        };
        let intrinsics = Intrinsics { width, height, fx, fy, cx: centre.x, cy: centre.y };
        Lens { intrinsics, distortion: self.distortion(lens.distortion) }
    }

    /// Radial terms look the same from every side. The tangential ones move p by 2 (t p) p + |p|^2
    /// t with t = (p2, p1), so t rotates like a direction.
    fn distortion(self, distortion: Distortion) -> Distortion {
        let turned = |[p1, p2]: [f64; 2]| {
            let t = self.0 * DVec2::new(p2, p1);
            [t.y, t.x]
        };
        match distortion {
            Distortion::None | Distortion::Fisheye { .. } => distortion,
            Distortion::Perspective { radial, tangential } => {
                Distortion::Perspective { radial, tangential: turned(tangential) }
            }
            Distortion::Polynomial { radial, tangential } => {
                Distortion::Polynomial { radial, tangential: turned(tangential) }
            }
        }
    }
}

/// The mirrored world, whose camera pictures are the mirrored pictures of this one.
pub fn mirror() -> DMat4 {
    DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0))
}
