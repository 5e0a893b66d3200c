//! The layouts of published data sets, which `capture` and `dataset` can read.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use glam::{DMat4, DVec3};
use serde_json::json;

use super::error::SynthError;
use crate::camera::Camera;
use crate::poses::bounds::{BoundedCamera, write_poses_bounds};

/// The layout of a synthetic capture's folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// LuSh-NeRF's: `images/`, sharp ones in `HL/`, `poses_bounds.npy`.
    #[default]
    Lush,
    /// LLFF's, with sharp photographs in `gt/`: `images/`, `poses_bounds.npy`.
    Llff,
    /// NeRF's, with sharp photographs in `gt/`: `images/`, `transforms.json`.
    Transforms,
}

impl Layout {
    pub const ALL: [Self; 3] = [Self::Lush, Self::Llff, Self::Transforms];

    pub fn name(self) -> &'static str {
        match self {
            Self::Lush => "lush",
            Self::Llff => "llff",
            Self::Transforms => "transforms",
        }
    }

    /// The folder of the sharp photographs.
    pub(super) fn truths(self) -> &'static str {
        match self {
            Self::Lush => "HL",
            Self::Llff | Self::Transforms => "gt",
        }
    }

    /// Writes the poses of the views with these names.
    ///
    /// # Errors
    /// [`SynthError::Poses`], [`SynthError::Io`].
    pub(super) fn write_poses(
        self,
        out: &Path,
        names: &[String],
        rows: &[BoundedCamera],
    ) -> Result<(), SynthError> {
        match self {
            Self::Lush | Self::Llff => Ok(write_poses_bounds(&out.join("poses_bounds.npy"), rows)?),
            Self::Transforms => {
                let path = out.join("transforms.json");
                let frames = names.iter().zip(rows).map(|(name, row)| {
                    json!({
                        "file_path": format!("images/{name}.png"),
                        "transform_matrix": camera_to_world(&row.camera),
                    })
                });
                let frames: Vec<_> = frames.collect();
                let optics = rows.first().map(|row| row.camera.intrinsics);
                let text = optics.map(|k| {
                    json!({
                        "w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy,
                        "cx": k.cx, "cy": k.cy, "frames": frames,
                    })
                });
                write(path, &text.unwrap_or_default().to_string())
            }
        }
    }
}

impl FromStr for Layout {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let mut all = Self::ALL.into_iter();
        all.find(|layout| layout.name() == name)
            .ok_or_else(|| format!("`{name}` is none of lush, llff, transforms"))
    }
}

/// Row by row, in OpenGL's axes: x right, y up, z backward.
fn camera_to_world(camera: &Camera) -> [[f64; 4]; 4] {
    let flip = DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0));
    let matrix = camera.world_to_camera.inverse() * flip;
    matrix.transpose().to_cols_array_2d()
}

fn write(path: PathBuf, text: &str) -> Result<(), SynthError> {
    std::fs::write(&path, text).map_err(|source| SynthError::Io { path, source })
}
