//! A photograph prepared to be compared, and how far away what it shows is.

use glam::{DMat3, DVec2, DVec3};

use crate::camera::Camera;
use crate::image::Image;

/// A photograph at the size at which it is compared.
#[derive(Debug)]
pub(super) struct StereoView {
    /// Its camera.
    pub(super) camera: Camera,
    /// sRGB-encoded.
    pub(super) image: Image,
    /// Luma, smoothed a little: what is compared.
    pub(super) luma: Vec<f32>,
}

impl StereoView {
    /// With its longest side at most `size`.
    pub(super) fn new(camera: &Camera, image: &Image, size: usize) -> Self {
        let (width, height) = image.size_at_most(size);
        let image = image.resize_area(width, height);
        let luma = smoothed(&image.luma(), width, height);
        Self {
            camera: camera.resized(width, height),
            image,
            luma,
        }
    }

    /// Its width and height, px.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.image.width(), self.image.height())
    }

    /// The ray through the middle of a pixel, in the camera's axes, with depth 1.
    pub(super) fn ray(&self, x: usize, y: usize) -> DVec3 {
        let k = &self.camera.intrinsics;
        let (x, y) = (x as f64 + 0.5, y as f64 + 0.5);
        DVec3::new((x - k.cx) / k.fx, (y - k.cy) / k.fy, 1.0)
    }

    /// From homogeneous pixels of this view at depth 1 to those of another, and what is added per
    /// inverse depth.
    pub(super) fn warp_to(&self, other: &Self) -> (DMat3, DVec3) {
        let matrix = |view: &Self| {
            let k = &view.camera.intrinsics;
            DMat3::from_cols(
                DVec3::new(k.fx, 0.0, 0.0),
                DVec3::new(0.0, k.fy, 0.0),
                DVec3::new(k.cx, k.cy, 1.0),
            )
        };
        let turn = other.camera.rotation() * self.camera.rotation().transpose();
        let shift = other.camera.translation() - turn * self.camera.translation();
        let to = matrix(other);
        (to * turn * matrix(self).inverse(), to * shift)
    }
}

/// Depth of what a photograph shows, a pixel; where it can be told.
#[derive(Debug)]
pub(super) struct DepthMap {
    /// World units along the camera's axis, row by row; 0 where nothing is known.
    pub(super) depths: Vec<f32>,
}

impl DepthMap {
    /// The depth at a place of the view's picture, px, where it is known.
    pub(super) fn at(&self, view: &StereoView, place: DVec2) -> Option<f64> {
        let (width, height) = view.size();
        let inside = place.x >= 0.0 && place.y >= 0.0;
        let (x, y) = (place.x as usize, place.y as usize);
        let known = inside && x < width && y < height;
        let depth = known.then(|| self.depths[y * width + x])?;
        (depth > 0.0).then(|| f64::from(depth))
    }
}

/// Weighted 1 2 1 along both axes: a Gaussian of 0.7 px.
fn smoothed(values: &[f32], width: usize, height: usize) -> Vec<f32> {
    let along = |values: &[f32], step: usize, place: fn(usize, usize) -> usize, side: usize| {
        let value = |i: usize| {
            let at = place(i, width);
            let before = if at == 0 { i } else { i - step };
            let after = if at + 1 == side { i } else { i + step };
            0.25 * (values[before] + values[after]) + 0.5 * values[i]
        };
        (0..values.len()).map(value).collect::<Vec<f32>>()
    };
    let rows = along(values, 1, |i, width| i % width, width);
    along(&rows, width, |i, width| i / width, height)
}
