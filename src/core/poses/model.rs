//! COLMAP's sparse models: cameras, images and points, as text or binary files.

mod binary;
mod text;

use std::path::Path;

use glam::{DMat4, DQuat, DVec3};

use super::{Distortion, Lens, PosesError, SparsePoint};
use crate::camera::{Camera, Intrinsics};

/// A model as it stands in a directory. Order of the files is kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseModel {
    /// Cameras (lenses with sensors), shared by images.
    pub cameras: Vec<ModelCamera>,
    /// Registered images.
    pub images: Vec<ModelImage>,
    /// Triangulated points.
    pub points: Vec<ModelPoint>,
}

/// A row of `cameras`.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelCamera {
    /// COLMAP's identifier.
    pub id: u32,
    /// The camera model.
    pub model: CameraModel,
    /// Image width, px.
    pub width: usize,
    /// Image height, px.
    pub height: usize,
    /// Parameters in COLMAP's order for the model.
    pub params: Vec<f64>,
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
    /// Which camera.
    pub camera_id: u32,
    /// File name relative to the image directory.
    pub name: String,
    /// Keypoints: x, y in px and the point they belong to.
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

/// COLMAP's camera models that we can undistort.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names are COLMAP's, in CameraModel::NAMES")]
pub enum CameraModel {
    SimplePinhole,
    Pinhole,
    SimpleRadial,
    Radial,
    OpenCv,
    OpenCvFisheye,
    FullOpenCv,
    SimpleRadialFisheye,
    RadialFisheye,
}

impl CameraModel {
    /// Model, COLMAP's number and name, and its count of parameters.
    const NAMES: [(Self, i32, &'static str, usize); 9] = [
        (Self::SimplePinhole, 0, "SIMPLE_PINHOLE", 3),
        (Self::Pinhole, 1, "PINHOLE", 4),
        (Self::SimpleRadial, 2, "SIMPLE_RADIAL", 4),
        (Self::Radial, 3, "RADIAL", 5),
        (Self::OpenCv, 4, "OPENCV", 8),
        (Self::OpenCvFisheye, 5, "OPENCV_FISHEYE", 8),
        (Self::FullOpenCv, 6, "FULL_OPENCV", 12),
        (Self::SimpleRadialFisheye, 8, "SIMPLE_RADIAL_FISHEYE", 4),
        (Self::RadialFisheye, 9, "RADIAL_FISHEYE", 5),
    ];

    fn row(self) -> (Self, i32, &'static str, usize) {
        Self::NAMES
            .into_iter()
            .find(|row| row.0 == self)
            .expect("every model has its row")
    }

    /// COLMAP's name.
    pub fn name(self) -> &'static str {
        self.row().2
    }

    /// How many parameters it has.
    pub fn parameters(self) -> usize {
        self.row().3
    }

    /// The model of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::NAMES
            .into_iter()
            .find(|row| row.2 == name)
            .map(|row| row.0)
    }

    fn number(self) -> i32 {
        self.row().1
    }

    fn from_number(number: i32) -> Option<Self> {
        Self::NAMES
            .into_iter()
            .find(|row| row.1 == number)
            .map(|row| row.0)
    }
}

impl ModelCamera {
    /// The lens this camera describes.
    pub fn lens(&self) -> Lens {
        let p = &self.params;
        let perspective =
            |radial: [f64; 6], tangential| Distortion::Perspective { radial, tangential };
        use CameraModel as M;
        let (fx, fy, cx, cy, distortion) = match self.model {
            M::SimplePinhole => (p[0], p[0], p[1], p[2], Distortion::None),
            M::Pinhole => (p[0], p[1], p[2], p[3], Distortion::None),
            M::SimpleRadial => (
                p[0],
                p[0],
                p[1],
                p[2],
                perspective([p[3], 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
            ),
            M::Radial => (
                p[0],
                p[0],
                p[1],
                p[2],
                perspective([p[3], p[4], 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
            ),
            M::OpenCv => (
                p[0],
                p[1],
                p[2],
                p[3],
                perspective([p[4], p[5], 0.0, 0.0, 0.0, 0.0], [p[6], p[7]]),
            ),
            M::FullOpenCv => {
                let radial = [p[4], p[5], p[8], p[9], p[10], p[11]];
                (p[0], p[1], p[2], p[3], perspective(radial, [p[6], p[7]]))
            }
            M::OpenCvFisheye => (
                p[0],
                p[1],
                p[2],
                p[3],
                Distortion::Fisheye {
                    radial: [p[4], p[5], p[6], p[7]],
                },
            ),
            M::SimpleRadialFisheye => (
                p[0],
                p[0],
                p[1],
                p[2],
                Distortion::Fisheye {
                    radial: [p[3], 0.0, 0.0, 0.0],
                },
            ),
            M::RadialFisheye => (
                p[0],
                p[0],
                p[1],
                p[2],
                Distortion::Fisheye {
                    radial: [p[3], p[4], 0.0, 0.0],
                },
            ),
        };
        let intrinsics = Intrinsics {
            width: self.width,
            height: self.height,
            fx,
            fy,
            cx,
            cy,
        };
        Lens {
            intrinsics,
            distortion,
        }
    }

    /// A camera with the lens: PINHOLE, FULL_OPENCV or OPENCV_FISHEYE.
    pub fn of_lens(id: u32, lens: &Lens) -> Self {
        let k = &lens.intrinsics;
        let (model, distortion) = match lens.distortion {
            Distortion::None => return Self::pinhole(id, k),
            Distortion::Perspective {
                radial: [k1, k2, k3, k4, k5, k6],
                tangential: [p1, p2],
            } => (
                CameraModel::FullOpenCv,
                vec![k1, k2, p1, p2, k3, k4, k5, k6],
            ),
            Distortion::Fisheye { radial } => (CameraModel::OpenCvFisheye, radial.to_vec()),
        };
        let params = [vec![k.fx, k.fy, k.cx, k.cy], distortion].concat();
        Self {
            id,
            model,
            width: k.width,
            height: k.height,
            params,
        }
    }

    /// A PINHOLE camera.
    pub fn pinhole(id: u32, k: &Intrinsics) -> Self {
        let params = vec![k.fx, k.fy, k.cx, k.cy];
        Self {
            id,
            model: CameraModel::Pinhole,
            width: k.width,
            height: k.height,
            params,
        }
    }
}

impl ModelImage {
    /// Rigid transform from world to camera.
    pub fn world_to_camera(&self) -> DMat4 {
        let [w, x, y, z] = self.rotation;
        let rotation = DQuat::from_xyzw(x, y, z, w).normalize();
        DMat4::from_rotation_translation(rotation, DVec3::from(self.translation))
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
    /// Reads `cameras`, `images` and `points3D`, `.bin` or `.txt`; binary wins where both stand.
    /// Files of newer versions (`rigs`, `frames`) repeat what a single-sensor model says already
    /// and are not read.
    ///
    /// # Errors
    /// [`PosesError::Io`] and [`PosesError::BadFile`]; a file cut short is an error, never a short
    /// model.
    pub fn read(dir: &Path) -> Result<Self, PosesError> {
        let model = if dir.join("cameras.bin").is_file() {
            binary::read(dir)
        } else {
            text::read(dir)
        }?;
        model.check(dir)?;
        Ok(model)
    }

    /// Writes the three text files.
    ///
    /// # Errors
    /// [`PosesError::Io`].
    pub fn write_text(&self, dir: &Path) -> Result<(), PosesError> {
        text::write(self, dir)
    }

    /// Writes the three binary files.
    ///
    /// # Errors
    /// [`PosesError::Io`].
    pub fn write_binary(&self, dir: &Path) -> Result<(), PosesError> {
        binary::write(self, dir)
    }

    /// Whether `dir` holds a model.
    pub fn stands_in(dir: &Path) -> bool {
        ["cameras.bin", "cameras.txt"]
            .iter()
            .any(|name| dir.join(name).is_file())
    }

    /// The camera of an image.
    pub fn camera_of(&self, image: &ModelImage) -> &ModelCamera {
        let camera = self
            .cameras
            .iter()
            .find(|camera| camera.id == image.camera_id);
        camera.expect("checked when the model was read")
    }

    /// Observations (members of tracks) over all points.
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

    /// The points as the pipeline wants them.
    pub fn sparse_points(&self) -> Vec<SparsePoint> {
        let point = |p: &ModelPoint| SparsePoint {
            position: p.position,
            colour: p.colour,
            error: p.error.max(0.0),
            track: p.track.len() as u32,
        };
        self.points.iter().map(point).collect()
    }

    /// Finite numbers, sizes above zero and no dangling camera: what everything after relies on.
    fn check(&self, dir: &Path) -> Result<(), PosesError> {
        let fault = |reason: String| Err(PosesError::bad_file(dir, reason));
        for camera in &self.cameras {
            let sized = camera.width > 0 && camera.height > 0;
            let focals = camera.lens().intrinsics;
            if !sized
                || focals.fx <= 0.0
                || focals.fy <= 0.0
                || !camera.params.iter().all(|p| p.is_finite())
            {
                return fault(format!("camera {} has no usable intrinsics", camera.id));
            }
        }
        for image in &self.images {
            if !self
                .cameras
                .iter()
                .any(|camera| camera.id == image.camera_id)
            {
                return fault(format!(
                    "image {} names camera {}, which is not there",
                    image.name, image.camera_id
                ));
            }
            let norm: f64 = image.rotation.iter().map(|q| q * q).sum();
            if !norm.is_finite() || norm < 1e-12 || !image.translation.iter().all(|t| t.is_finite())
            {
                return fault(format!("image {} has no usable pose", image.name));
            }
        }
        match self
            .points
            .iter()
            .find(|point| !point.position.iter().all(|v| v.is_finite()))
        {
            Some(point) => fault(format!("point {} is not finite", point.id)),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
