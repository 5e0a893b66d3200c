//! A photograph of a capture and its outcome.

use std::path::PathBuf;

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

/// The outcome for one file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Assessment {
    /// The path as uploaded, below the folder of the photographs; numbered if others have the same.
    pub name: String,
    /// Whether it is used.
    pub accepted: bool,
    /// The reason if it is not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Whether its format is known but unsupported (HEIC, raw): HTTP 415 rather than 422.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unsupported_format: bool,
    /// Width of the upright photograph, px; 0 if it is unreadable.
    pub width: usize,
    /// Height of the upright photograph, px; 0 if it is unreadable.
    pub height: usize,
    /// Focal length in px, from EXIF.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_px: Option<f64>,
    /// The colour profile that is applied, or the camera of a raw file; none where the values are
    /// sRGB's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colours: Option<String>,
    /// Mean of the brightest channel, as a share of white; only if the photograph is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brightness: Option<f32>,
    /// Sharpness relative to the capture's median; only if the photograph is used. Comparable
    /// within one capture only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sharpness: Option<f32>,
    /// What the user should know about it.
    pub warnings: Vec<CaptureWarning>,
}

/// Information that does not stop the work.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaptureWarning {
    /// Stable snake_case code: `dark`, `blurred`, `hdr`, `mixed_sizes`, `few` and others.
    pub code: String,
    /// One sentence, with figures.
    pub message: String,
}

impl CaptureWarning {
    pub(crate) fn new(code: &str, message: impl Into<String>) -> Self {
        Self { code: code.to_owned(), message: message.into() }
    }
}
