//! NeRF's `transforms.json`: camera-to-world matrices with OpenGL axes (x right, y up, z
//! backward), intrinsics for all frames or frame by frame.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DMat4, DVec3, DVec4};
use serde::Deserialize;

use super::given_view::{Focal, GivenLens, GivenView};
use crate::camera::Intrinsics;
use crate::photo_path::PhotoPath;
use crate::poses::{Distortion, Lens, PosesError};

/// Intrinsics as instant-ngp and nerfstudio write them; a frame's own win over the file's.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
struct Optics {
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct Transforms {
    #[serde(flatten)]
    optics: Optics,
    camera_model: Option<String>,
    #[serde(default)]
    is_fisheye: bool,
    frames: Vec<Frame>,
}

#[derive(Debug, Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: [[f64; 4]; 4],
    #[serde(flatten)]
    optics: Optics,
}

/// The frames with the paths of their files.
pub(super) fn read(file: &Path) -> Result<Vec<(PhotoPath, GivenView)>, PosesError> {
    let bytes = std::fs::read(file).map_err(PosesError::io(file))?;
    let transforms: Transforms =
        serde_json::from_slice(&bytes).map_err(|e| PosesError::bad_file(file, e.to_string()))?;
    let fisheye =
        transforms.is_fisheye || transforms.camera_model.as_deref() == Some("OPENCV_FISHEYE");
    let view = |frame: &Frame| {
        let bad = |what| PosesError::bad_file(file, format!("frame {}: {what}", frame.file_path));
        let lens = frame
            .optics
            .or(&transforms.optics)
            .lens(fisheye)
            .ok_or_else(|| bad("no usable intrinsics"))?;
        let world_to_camera =
            world_to_camera(&frame.transform_matrix).ok_or_else(|| bad("no rigid transform"))?;
        Ok((
            PhotoPath::new(&frame.file_path),
            GivenView {
                lens,
                world_to_camera,
                bounds: None,
            },
        ))
    };
    transforms.frames.iter().map(view).collect()
}

/// OpenGL camera-to-world to OpenCV world-to-camera.
fn world_to_camera(matrix: &[[f64; 4]; 4]) -> Option<DMat4> {
    let rows = matrix.map(DVec4::from_array);
    let camera_to_world = DMat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose();
    let rigid = (camera_to_world.determinant() - 1.0).abs() < 1e-3 && camera_to_world.is_finite();
    let flip = DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0));
    rigid.then(|| (camera_to_world * flip).inverse())
}

impl Optics {
    fn or(&self, other: &Self) -> Self {
        Self {
            w: self.w.or(other.w),
            h: self.h.or(other.h),
            fl_x: self.fl_x.or(other.fl_x),
            fl_y: self.fl_y.or(other.fl_y),
            cx: self.cx.or(other.cx),
            cy: self.cy.or(other.cy),
            camera_angle_x: self.camera_angle_x.or(other.camera_angle_x),
            k1: self.k1.or(other.k1),
            k2: self.k2.or(other.k2),
            k3: self.k3.or(other.k3),
            k4: self.k4.or(other.k4),
            p1: self.p1.or(other.p1),
            p2: self.p2.or(other.p2),
        }
    }

    /// Without a size there is nothing to scale by: the pixels are then the photograph's own.
    fn lens(&self, fisheye: bool) -> Option<GivenLens> {
        let distortion = self.distortion(fisheye);
        match (self.w, self.h) {
            (Some(width), Some(height)) => self.intrinsics(width, height).map(|intrinsics| {
                GivenLens::Sized(Lens {
                    intrinsics,
                    distortion,
                })
            }),
            (None, None) => self.focal().map(|focal| GivenLens::OfPhotograph {
                focal,
                centre: [self.cx, self.cy],
                distortion,
            }),
            _ => None,
        }
    }

    fn focal(&self) -> Option<Focal> {
        let is_angle = |angle: &f64| *angle > 0.0 && *angle < PI;
        match (self.fl_x, self.camera_angle_x) {
            (Some(fx), _) => {
                let fy = self.fl_y.unwrap_or(fx);
                (fx > 0.0 && fy > 0.0).then_some(Focal::Pixels([fx, fy]))
            }
            (None, angle) => angle.filter(is_angle).map(Focal::Angle),
        }
    }

    fn intrinsics(&self, width: f64, height: f64) -> Option<Intrinsics> {
        let from_angle = self
            .camera_angle_x
            .map(|angle| 0.5 * width / (0.5 * angle).tan());
        let fx = self.fl_x.or(from_angle)?;
        let fy = self.fl_y.unwrap_or(fx);
        let sized = width >= 1.0 && height >= 1.0 && fx > 0.0 && fy > 0.0;
        sized.then_some(Intrinsics {
            width: width.round() as usize,
            height: height.round() as usize,
            fx,
            fy,
            cx: self.cx.unwrap_or(0.5 * width),
            cy: self.cy.unwrap_or(0.5 * height),
        })
    }

    fn distortion(&self, fisheye: bool) -> Distortion {
        let [k1, k2, k3, k4] = [self.k1, self.k2, self.k3, self.k4].map(|k| k.unwrap_or(0.0));
        // k4 of a perspective file is OpenCV's first denominator term.
        if fisheye {
            Distortion::Fisheye {
                radial: [k1, k2, k3, k4],
            }
        } else {
            let tangential = [self.p1.unwrap_or(0.0), self.p2.unwrap_or(0.0)];
            Distortion::Perspective {
                radial: [k1, k2, k3, k4, 0.0, 0.0],
                tangential,
            }
        }
    }
}
