//! COLMAP's cameras: lenses with sensors.

use std::path::Path;

use crate::camera::Intrinsics;
use crate::poses::{Distortion, Lens, PoseFileError};

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

/// COLMAP camera models that can be undistorted, by COLMAP's names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    SimpleFisheye,
    Fisheye,
}

impl CameraModel {
    /// Model, COLMAP's number and name, and parameter count.
    pub(super) const NAMES: [(Self, i32, &'static str, usize); 11] = [
        (Self::SimplePinhole, 0, "SIMPLE_PINHOLE", 3),
        (Self::Pinhole, 1, "PINHOLE", 4),
        (Self::SimpleRadial, 2, "SIMPLE_RADIAL", 4),
        (Self::Radial, 3, "RADIAL", 5),
        (Self::OpenCv, 4, "OPENCV", 8),
        (Self::OpenCvFisheye, 5, "OPENCV_FISHEYE", 8),
        (Self::FullOpenCv, 6, "FULL_OPENCV", 12),
        (Self::SimpleRadialFisheye, 8, "SIMPLE_RADIAL_FISHEYE", 4),
        (Self::RadialFisheye, 9, "RADIAL_FISHEYE", 5),
        (Self::SimpleFisheye, 14, "SIMPLE_FISHEYE", 3),
        (Self::Fisheye, 15, "FISHEYE", 4),
    ];

    /// Number, name and parameter count of unsupported models, as in COLMAP 4.1's
    /// `src/colmap/sensor/models.h` and `models/*.h`.
    const UNREAD: [(i32, &'static str, u64); 7] = [
        (7, "FOV", 5),
        (10, "THIN_PRISM_FISHEYE", 12),
        (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
        (12, "SIMPLE_DIVISION", 4),
        (13, "DIVISION", 5),
        (16, "EUCM", 6),
        (17, "EQUIRECTANGULAR", 2),
    ];

    fn row(self) -> (Self, i32, &'static str, usize) {
        Self::NAMES.into_iter().find(|row| row.0 == self).expect("every model has its row")
    }

    fn has_one_focal_length(self) -> bool {
        use CameraModel as M;
        matches!(
            self,
            M::SimplePinhole
                | M::SimpleRadial
                | M::Radial
                | M::SimpleRadialFisheye
                | M::RadialFisheye
                | M::SimpleFisheye
        )
    }

    /// COLMAP's name.
    pub fn name(self) -> &'static str {
        self.row().2
    }

    /// Its parameter count.
    pub fn parameters(self) -> usize {
        self.row().3
    }

    /// The message for any other model.
    pub(super) fn unread(name: &str) -> String {
        format!(
            "camera model {name} is not read; undistort the photographs (`colmap \
             image_undistorter`), or use one of {}",
            Self::NAMES.map(|row| row.2).join(", ")
        )
    }

    /// COLMAP's name of any other model, or else its number, and its parameter count.
    pub(super) fn unread_name(number: i32) -> (String, Option<u64>) {
        let known = Self::UNREAD.iter().find(|(id, ..)| *id == number);
        match known {
            Some((_, name, count)) => ((*name).to_owned(), Some(*count)),
            None => (number.to_string(), None),
        }
    }

    /// The model with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.into_iter().find(|row| row.2.eq_ignore_ascii_case(name)).map(|row| row.0)
    }

    pub(super) fn number(self) -> i32 {
        self.row().1
    }

    pub(super) fn from_number(number: i32) -> Option<Self> {
        Self::NAMES.into_iter().find(|row| row.1 == number).map(|row| row.0)
    }
}

/// A camera of an unsupported model.
#[derive(Debug)]
pub(super) struct UnreadCamera {
    pub(super) id: u32,
    /// Names the model, with advice.
    pub(super) reason: String,
}

/// A row of `cameras`.
pub(super) type CameraRow = Result<ModelCamera, UnreadCamera>;

/// The supported cameras, and the unsupported ones.
///
/// # Errors
/// [`PoseFileError::BadFile`] if there are cameras and none is supported.
pub(super) fn read_of(
    file: &Path,
    rows: Vec<CameraRow>,
) -> Result<(Vec<ModelCamera>, Vec<UnreadCamera>), PoseFileError> {
    let (mut read, mut unread) = (Vec::new(), Vec::new());
    for row in rows {
        match row {
            Ok(camera) => read.push(camera),
            Err(camera) => unread.push(camera),
        }
    }
    match unread.first() {
        Some(camera) if read.is_empty() => Err(PoseFileError::bad_file(file, &*camera.reason)),
        _ => Ok((read, unread)),
    }
}

impl ModelCamera {
    /// Whether its numbers are finite, and sizes and focal lengths above zero.
    pub(super) fn is_usable(&self) -> bool {
        let Intrinsics { fx, fy, .. } = self.lens().intrinsics;
        let is_sized = self.width > 0 && self.height > 0 && fx > 0.0 && fy > 0.0;
        is_sized && self.params.iter().all(|p| p.is_finite())
    }

    /// The lens this camera describes.
    pub fn lens(&self) -> Lens {
        let p = &self.params;
        // One focal length, or one per axis.
        let (fx, fy, cx, cy) = match self.model.has_one_focal_length() {
            true => (p[0], p[0], p[1], p[2]),
            false => (p[0], p[1], p[2], p[3]),
        };
        let intrinsics = Intrinsics { width: self.width, height: self.height, fx, fy, cx, cy };
        Lens { intrinsics, distortion: self.distortion() }
    }

    fn distortion(&self) -> Distortion {
        let p = &self.params;
        let perspective =
            |radial: [f64; 6], tangential| Distortion::Perspective { radial, tangential };
        let fisheye = |radial: [f64; 4]| Distortion::Fisheye { radial };
        let radial = |k1, k2| [k1, k2, 0.0, 0.0, 0.0, 0.0];
        use CameraModel as M;
        match self.model {
            M::SimplePinhole | M::Pinhole => Distortion::None,
            M::SimpleRadial => perspective(radial(p[3], 0.0), [0.0; 2]),
            M::Radial => perspective(radial(p[3], p[4]), [0.0; 2]),
            M::OpenCv => perspective(radial(p[4], p[5]), [p[6], p[7]]),
            M::FullOpenCv => perspective([p[4], p[5], p[8], p[9], p[10], p[11]], [p[6], p[7]]),
            M::OpenCvFisheye => fisheye([p[4], p[5], p[6], p[7]]),
            M::SimpleRadialFisheye => fisheye([p[3], 0.0, 0.0, 0.0]),
            M::RadialFisheye => fisheye([p[3], p[4], 0.0, 0.0]),
            M::SimpleFisheye | M::Fisheye => fisheye([0.0; 4]),
        }
    }

    /// A camera with the lens: PINHOLE, FULL_OPENCV or OPENCV_FISHEYE. COLMAP has no polynomial of
    /// four terms; the fraction used instead differs by far less than a pixel within the picture.
    pub fn of_lens(id: u32, lens: &Lens) -> Self {
        let k = &lens.intrinsics;
        let full = |[k1, k2, k3, k4, k5, k6]: [f64; 6], [p1, p2]: [f64; 2]| {
            let terms = vec![k1, k2, p1, p2, k3, k4, k5, k6];
            (CameraModel::FullOpenCv, terms)
        };
        let (model, distortion) = match lens.distortion {
            Distortion::None => return Self::pinhole(id, k),
            Distortion::Perspective { radial, tangential } => full(radial, tangential),
            Distortion::Polynomial { radial, tangential } => {
                let [k1, k2, k3, _] = radial;
                let fraction = lens.fraction(radial);
                full(fraction.unwrap_or([k1, k2, k3, 0.0, 0.0, 0.0]), tangential)
            }
            Distortion::Fisheye { radial } => (CameraModel::OpenCvFisheye, radial.to_vec()),
        };
        let params = [vec![k.fx, k.fy, k.cx, k.cy], distortion].concat();
        Self { id, model, width: k.width, height: k.height, params }
    }

    /// A PINHOLE camera.
    pub fn pinhole(id: u32, k: &Intrinsics) -> Self {
        let params = vec![k.fx, k.fy, k.cx, k.cy];
        Self { id, model: CameraModel::Pinhole, width: k.width, height: k.height, params }
    }
}
