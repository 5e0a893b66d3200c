//! A photograph of a capture and its outcome.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::Shot;
use crate::photo_path::PhotoPath;

use super::prepared::PreparedImage;

/// One accepted photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CaptureView {
    /// Our own name: letters, digits, `-`, `_`, at most 40, unique even ignoring case.
    pub name: String,
    /// The owner's path below the folder of the photographs, never a path on this machine.
    pub path: PhotoPath,
    /// The original, until it is prepared; none in a capture that was prepared before.
    #[serde(skip)]
    pub file: PathBuf,
    /// The image that the pipeline reads instead.
    pub prepared: PreparedImage,
    /// Width of the upright photograph, px.
    pub width: usize,
    /// Height of the upright photograph, px.
    pub height: usize,
    /// How the stored pixels are turned upright, as in EXIF: 1 to 8.
    pub orientation: u8,
    /// Focal length in px, from EXIF.
    pub focal_px: Option<f64>,
    /// The exposure, from EXIF.
    pub shot: Option<Shot>,
    /// Its sharp ground truth.
    pub gt: Option<PreparedImage>,
    /// How much each of its pixels counts, 0 to 1, if it has masks.
    pub mask: Option<PreparedImage>,
}

impl CaptureView {
    /// A photograph stored upright and without EXIF, of the size of its prepared image.
    pub fn upright(name: String, path: PhotoPath, prepared: PreparedImage) -> Self {
        Self {
            name,
            path,
            file: PathBuf::new(),
            width: prepared.width,
            height: prepared.height,
            prepared,
            orientation: 1,
            focal_px: None,
            shot: None,
            gt: None,
            mask: None,
        }
    }
}

/// The assessment of one photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Assessment {
    /// Path as sent, below the folder of the photographs; numbered if sent more than once.
    pub name: String,
    /// The name of its view in the results of jobs; of a photograph that is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view: Option<String>,
    /// Whether the photograph is used.
    pub accepted: bool,
    /// Why it is not used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Whether its format is known but unsupported: HTTP 415 rather than 422. Not kept.
    #[serde(skip)]
    pub unsupported_format: bool,
    /// Upright width, px; 0 if unreadable.
    pub width: usize,
    /// Upright height, px; 0 if unreadable.
    pub height: usize,
    /// Focal length from EXIF, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_px: Option<f64>,
    /// The colour profile that is applied, or the camera of a raw file; none for sRGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colours: Option<String>,
    /// Mean of the brightest channel, 0 to 1; of a photograph that is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brightness: Option<f32>,
    /// Sharpness relative to the capture's median; of a photograph that is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sharpness: Option<f32>,
    /// Warnings: dark, blurred, a duplicate and so on.
    pub warnings: Vec<CaptureWarning>,
}

impl Assessment {
    /// The assessment of a file that is not used.
    pub fn refused(name: String, reason: String) -> Self {
        Self {
            name,
            view: None,
            accepted: false,
            reason: Some(reason),
            unsupported_format: false,
            width: 0,
            height: 0,
            focal_px: None,
            colours: None,
            brightness: None,
            sharpness: None,
            warnings: Vec::new(),
        }
    }
}

/// A warning; the work continues.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Warning")]
pub struct CaptureWarning {
    /// Stable code.
    pub code: String,
    /// One sentence.
    pub message: String,
}

impl CaptureWarning {
    /// A warning with figures in its message.
    pub fn new(code: &str, message: impl Into<String>) -> Self {
        Self { code: code.to_owned(), message: message.into() }
    }
}
