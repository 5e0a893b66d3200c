//! Pinhole cameras. Axes as in OpenCV: x right, y down, z forward; pixel centres at +0.5.

pub mod normalisation;
pub mod orbit;
pub mod upright;

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Pinhole intrinsics in pixels of an image of `width` x `height`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width, px.
    pub width: usize,
    /// Image height, px.
    pub height: usize,
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Principal point x, px (0 is the left edge, not the first pixel's centre).
    pub cx: f64,
    /// Principal point y, px.
    pub cy: f64,
}

impl Intrinsics {
    /// The same camera seen through an image resampled to `width` x `height`.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
        }
    }
}

/// A calibrated, posed pinhole camera. As JSON its matrix is 16 numbers, column-major.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Pixels.
    pub intrinsics: Intrinsics,
    /// Rigid transform from world to camera coordinates, world units.
    pub world_to_camera: DMat4,
}

impl Camera {
    /// From a rotation (world to camera) and translation, as COLMAP stores poses.
    pub fn from_pose(intrinsics: Intrinsics, rotation: DQuat, translation: DVec3) -> Self {
        Self {
            intrinsics,
            world_to_camera: DMat4::from_rotation_translation(rotation, translation),
        }
    }

    /// A camera at `eye` that looks at `target`; `down` is the world direction that points down in
    /// the image.
    pub fn look_at(intrinsics: Intrinsics, eye: DVec3, target: DVec3, down: DVec3) -> Self {
        let z = (target - eye).normalize();
        let x = down.cross(z).normalize();
        let y = z.cross(x);
        let rotation = DMat3::from_cols(x, y, z).transpose();
        Self {
            intrinsics,
            world_to_camera: DMat4::from_cols(
                rotation.x_axis.extend(0.0),
                rotation.y_axis.extend(0.0),
                rotation.z_axis.extend(0.0),
                (-(rotation * eye)).extend(1.0),
            ),
        }
    }

    /// Width and height of its image, px.
    pub fn size(&self) -> [usize; 2] {
        [self.intrinsics.width, self.intrinsics.height]
    }

    /// Rotation part, world to camera.
    pub fn rotation(&self) -> DMat3 {
        DMat3::from_mat4(self.world_to_camera)
    }

    /// Translation part, world to camera.
    pub fn translation(&self) -> DVec3 {
        self.world_to_camera.w_axis.truncate()
    }

    /// Centre of projection in world units.
    pub fn centre(&self) -> DVec3 {
        -(self.rotation().transpose() * self.translation())
    }

    /// Unit viewing direction in the world.
    pub fn forward(&self) -> DVec3 {
        self.rotation().transpose() * DVec3::Z
    }

    /// The unit world direction that points right in the image.
    pub fn right(&self) -> DVec3 {
        self.rotation().transpose() * DVec3::X
    }

    /// The unit world direction that points down in the image.
    pub fn down(&self) -> DVec3 {
        self.rotation().transpose() * DVec3::Y
    }

    /// Pixel and depth of a world point; `None` behind the camera.
    pub fn project(&self, point: DVec3) -> Option<(DVec2, f64)> {
        let p = self.world_to_camera.transform_point3(point);
        if p.z <= 1e-9 {
            return None;
        }
        let k = &self.intrinsics;
        Some((DVec2::new(k.fx * p.x / p.z + k.cx, k.fy * p.y / p.z + k.cy), p.z))
    }

    /// Pixel and depth of a world point inside the picture.
    pub fn shows(&self, point: DVec3) -> Option<(DVec2, f64)> {
        let size = DVec2::new(self.intrinsics.width as f64, self.intrinsics.height as f64);
        let inside = |pixel: DVec2| pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
        self.project(point).filter(|(pixel, _)| inside(*pixel))
    }

    /// The same pose with the image resampled to `width` x `height`.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        Self { intrinsics: self.intrinsics.resized(width, height), ..*self }
    }
}

/// A camera of the delivered scene: one entry of `cameras.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedCamera {
    /// The view's name.
    pub name: String,
    /// Pixels.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
    /// Row-major 4x4, OpenCV axes.
    pub world_to_camera: [[f64; 4]; 4],
    /// Whether the view trained the scene.
    pub split: Split,
}

/// Which set a view belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Used to train the scene.
    Train,
    /// Registered, but kept out of training.
    HeldOut,
}

impl NamedCamera {
    /// From a camera.
    pub fn new(name: impl Into<String>, camera: &Camera, split: Split) -> Self {
        Self {
            name: name.into(),
            intrinsics: camera.intrinsics,
            world_to_camera: camera.world_to_camera.transpose().to_cols_array_2d(),
            split,
        }
    }

    /// The camera of this entry.
    pub fn camera(&self) -> Camera {
        Camera {
            intrinsics: self.intrinsics,
            world_to_camera: DMat4::from_cols_array_2d(&self.world_to_camera).transpose(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intrinsics() -> Intrinsics {
        Intrinsics { width: 200, height: 100, fx: 150.0, fy: 150.0, cx: 100.0, cy: 50.0 }
    }

    #[test]
    fn look_at_puts_the_target_in_the_middle_and_down_below() {
        let eye = DVec3::new(1.0, 2.0, -5.0);
        let camera = Camera::look_at(intrinsics(), eye, DVec3::ZERO, DVec3::Y);
        let (pixel, depth) = camera.project(DVec3::ZERO).expect("in front");
        assert!((pixel - DVec2::new(100.0, 50.0)).length() < 1e-9);
        assert!((depth - eye.length()).abs() < 1e-9);
        let (below, _) = camera.project(DVec3::Y * 0.1).expect("in front");
        assert!(below.y > 50.0);
        assert!((camera.centre() - eye).length() < 1e-12);
        assert!((camera.rotation().determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_named_camera_is_row_major_and_round_trips() {
        let camera =
            Camera::look_at(intrinsics(), DVec3::new(1.0, 2.0, -5.0), DVec3::ZERO, DVec3::Y);
        let named = NamedCamera::new("a", &camera, Split::HeldOut);
        assert!((named.world_to_camera[0][3] - camera.translation().x).abs() < 1e-12);
        assert_eq!(named.camera(), camera);
    }
}
