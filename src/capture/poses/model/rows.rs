//! The contents of a sparse model.

use std::collections::HashSet;
use std::path::Path;

use glam::{DMat4, DQuat, DVec3};

use super::camera::{ModelCamera, UnreadCamera};
use crate::camera::Camera;
use crate::poses::{LeftOut, PoseFileError, SparsePoint};

/// A model as stored in a directory, in file order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseModel {
    /// Cameras (lenses with sensors), shared by images.
    pub cameras: Vec<ModelCamera>,
    /// Registered images.
    pub images: Vec<ModelImage>,
    /// Triangulated points.
    pub points: Vec<ModelPoint>,
}

/// A row of `images`.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelImage {
    /// COLMAP's identifier.
    pub id: u32,
    /// World to camera, w x y z.
    pub rotation: [f64; 4],
    /// World to camera.
    pub translation: [f64; 3],
    /// Identifier of the camera.
    pub camera_id: u32,
    /// File name relative to the image directory.
    pub name: String,
    /// Keypoints: x, y in px and the point that they belong to.
    pub keypoints: Vec<(f64, f64, Option<u64>)>,
}

/// A row of `points3D`.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelPoint {
    /// COLMAP's identifier.
    pub id: u64,
    /// World units.
    pub position: [f64; 3],
    /// sRGB.
    pub colour: [u8; 3],
    /// Mean reprojection error, px.
    pub error: f64,
    /// Image identifier and index of the keypoint in it.
    pub track: Vec<(u32, u32)>,
}

impl ModelImage {
    /// Rigid transform from world to camera.
    pub fn world_to_camera(&self) -> DMat4 {
        let [w, x, y, z] = self.rotation;
        let rotation = DQuat::from_xyzw(x, y, z, w).normalize();
        DMat4::from_rotation_translation(rotation, DVec3::from(self.translation))
    }

    fn is_usable(&self) -> bool {
        let norm: f64 = self.rotation.iter().map(|q| q * q).sum();
        norm.is_finite() && norm >= 1e-12 && self.translation.iter().all(|t| t.is_finite())
    }

    /// An image without keypoints.
    pub fn posed(id: u32, camera_id: u32, name: impl Into<String>, camera: &Camera) -> Self {
        let q = DQuat::from_mat3(&camera.rotation());
        Self {
            id,
            rotation: [q.w, q.x, q.y, q.z],
            translation: camera.translation().to_array(),
            camera_id,
            name: name.into(),
            keypoints: Vec::new(),
        }
    }
}

impl SparseModel {
    /// A model of posed images and coloured points without matches: views with equal intrinsics
    /// share a camera.
    pub fn of_views(
        views: impl IntoIterator<Item = (String, Camera)>,
        points: impl IntoIterator<Item = ([f64; 3], [u8; 3])>,
    ) -> Self {
        let mut model = Self::default();
        for (id, (name, camera)) in (1..).zip(views) {
            let next = model.cameras.len() as u32 + 1;
            let own = ModelCamera::pinhole(next, &camera.intrinsics);
            let same = model.cameras.iter().find(|known| known.lens() == own.lens());
            let camera_id = same.map_or(next, |known| known.id);
            let image = ModelImage::posed(id, camera_id, name, &camera);
            if camera_id == next {
                model.cameras.push(own);
            }
            model.images.push(image);
        }
        let point = |(id, (position, colour))| ModelPoint {
            id,
            position,
            colour,
            error: 0.0,
            track: Vec::new(),
        };
        model.points = (1..).zip(points).map(point).collect();
        model
    }

    /// The camera of an image.
    pub fn camera_of(&self, image: &ModelImage) -> &ModelCamera {
        let camera = self.cameras.iter().find(|camera| camera.id == image.camera_id);
        camera.expect("checked when the model was read")
    }

    /// Observations (track members) over all points.
    pub fn observations(&self) -> usize {
        self.points.iter().map(|point| point.track.len()).sum()
    }

    /// Mean number of images that see a point; `None` without points.
    pub fn mean_track(&self) -> Option<f64> {
        (!self.points.is_empty()).then(|| self.observations() as f64 / self.points.len() as f64)
    }

    /// Mean of the points' reprojection errors, px; `None` without points.
    pub fn mean_error(&self) -> Option<f64> {
        let sum: f64 = self.points.iter().map(|point| point.error).sum();
        (!self.points.is_empty()).then(|| sum / self.points.len() as f64)
    }

    /// Mean reprojection error of the points that the image with this name sees, px.
    pub fn error_of(&self, name: &str) -> Option<f64> {
        let id = self.images.iter().find(|image| image.name == name)?.id;
        let sees = |point: &&ModelPoint| point.track.iter().any(|(image, _)| *image == id);
        let errors: Vec<f64> = self.points.iter().filter(sees).map(|p| p.error).collect();
        (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
    }

    /// The points in the pipeline's form.
    pub fn sparse_points(&self) -> Vec<SparsePoint> {
        let point = |p: &ModelPoint| SparsePoint {
            position: p.position,
            colour: p.colour,
            error: if p.error.is_finite() { p.error.max(0.0) } else { 0.0 },
            track: p.track.len() as u32,
        };
        self.points.iter().map(point).collect()
    }

    /// Keeps the rows with finite numbers, sizes above zero and supported cameras, and names the
    /// others.
    pub(super) fn keep_usable(
        &mut self,
        dir: &Path,
        unread: &[UnreadCamera],
    ) -> Result<Vec<LeftOut>, PoseFileError> {
        let mut left_out = Vec::new();
        for image in &self.images {
            if let Some(camera) = unread.iter().find(|camera| camera.id == image.camera_id) {
                left_out.push(LeftOut::new(&image.name, &*camera.reason));
                continue;
            }
            let camera = self.cameras.iter().find(|camera| camera.id == image.camera_id);
            let camera = camera.ok_or_else(|| {
                let (name, id) = (&image.name, image.camera_id);
                let reason = format!("image {name} names camera {id}, which is not there");
                PoseFileError::bad_file(dir, reason)
            })?;
            if !camera.is_usable() {
                let reason = format!("camera {} has no usable intrinsics", camera.id);
                left_out.push(LeftOut::new(&image.name, reason));
            } else if !image.is_usable() {
                left_out.push(LeftOut::new(&image.name, "its pose holds no usable numbers"));
            }
        }
        let is_good: HashSet<u32> = self
            .cameras
            .iter()
            .filter(|camera| camera.is_usable())
            .map(|camera| camera.id)
            .collect();
        self.images.retain(|image| image.is_usable() && is_good.contains(&image.camera_id));
        self.cameras.retain(|camera| is_good.contains(&camera.id));
        let is_finite = |point: &ModelPoint| point.position.iter().all(|v| v.is_finite());
        let bad = self.points.iter().filter(|point| !is_finite(point)).count();
        if bad > 0 {
            let name = format!("{bad} points");
            left_out.push(LeftOut::new(name, "their positions are not finite"));
        }
        self.points.retain(is_finite);
        Ok(left_out)
    }
}
