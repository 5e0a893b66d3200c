//! Validation of an upload with the pipeline's own capture reader.

use std::fs;
use std::path::{Path, PathBuf};

use fled_core::capture::{self, CaptureError, CaptureWarning, Inspection, Placement, Watch};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::redaction::without_paths;

/// The name under which an uploaded zip is stored.
pub const ARCHIVE: &str = "upload.zip";

/// The assessments of an upload.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CaptureReport {
    /// Number of usable photographs.
    pub accepted: u32,
    /// One assessment per file.
    pub images: Vec<Assessment>,
    /// Warnings about the whole capture.
    pub warnings: Vec<Warning>,
}

/// The assessment of one photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Assessment {
    /// Path as sent, below the folder of the photographs; numbered if sent more than once.
    pub name: String,
    /// The name of its view in the results of jobs; of a photograph that is used, once stored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view: Option<String>,
    /// Whether the photograph is used.
    pub accepted: bool,
    /// Why it is not used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
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
    pub warnings: Vec<Warning>,
}

/// A warning; the work continues.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Warning {
    /// Stable code.
    pub code: String,
    /// One sentence.
    pub message: String,
}

/// Why an upload is no usable capture.
#[derive(Debug, Serialize, Deserialize)]
pub struct Refusal {
    /// What is wrong.
    pub detail: String,
    /// What to do about it.
    pub hint: String,
    /// Whether photographs in an unsupported format are the reason.
    pub unsupported_format: bool,
    /// Whether the machine is at fault, not the upload.
    pub is_ours: bool,
    /// The assessments so far.
    pub report: CaptureReport,
}

/// Validates the content of `dir`: a single archive, or the files of a capture folder. A zip stays
/// packed, because only inside it do its files have their names. It decodes untrusted files, so
/// call it only in a process that may die.
///
/// # Errors
/// [`Refusal`] if it is no usable capture.
pub fn examine(dir: &Path, watch: &Watch<'_>) -> Result<CaptureReport, Box<Refusal>> {
    let archive = dir.join(ARCHIVE);
    let opened = if archive.is_file() {
        if dir.read_dir().is_ok_and(|entries| entries.count() > 1) {
            return Err(mixed());
        }
        let scratch = dir.join(".examined");
        let opened = Inspection::of(&archive, &scratch, watch);
        match fs::remove_dir_all(&scratch) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                let path = scratch;
                return Err(refuse(dir, CaptureError::Io { path, source }));
            }
            _ => opened,
        }
    } else {
        Inspection::of(dir, dir, watch)
    };
    let inspection = opened.map_err(|error| refuse(dir, error))?;
    if let Some(Placement::Unusable { file, reason }) =
        inspection.poses.as_ref().map(|poses| &poses.placement)
    {
        return Err(bad_poses(&inspection, &format!("{file}: {reason}")));
    }
    Ok(CaptureReport {
        accepted: u32::try_from(inspection.accepted).unwrap_or(u32::MAX),
        images: inspection.assessments.into_iter().map(assessment).collect(),
        warnings: inspection.warnings.into_iter().map(warning).collect(),
    })
}

fn bad_poses(inspection: &Inspection, fault: &str) -> Box<Refusal> {
    Box::new(Refusal {
        detail: without_paths(&format!("The poses cannot be read: {fault}")),
        hint: "Fix the file, or leave it out: then fled finds the poses.".to_owned(),
        unsupported_format: false,
        is_ours: false,
        report: CaptureReport {
            accepted: u32::try_from(inspection.accepted).unwrap_or(u32::MAX),
            images: inspection.assessments.iter().cloned().map(assessment).collect(),
            warnings: Vec::new(),
        },
    })
}

/// Bytes that validating `dir` needs temporarily: those of an unpacked zip.
///
/// # Errors
/// [`Refusal`] if the zip cannot be unpacked.
pub fn unpacked_bytes(dir: &Path) -> Result<u64, Box<Refusal>> {
    let archive = dir.join(ARCHIVE);
    if !archive.is_file() {
        return Ok(0);
    }
    capture::unpacked_bytes(&archive).map_err(|error| refuse(dir, error))
}

/// The pipeline's input of a stored capture: its zip, or its folder.
pub fn source(dir: PathBuf) -> PathBuf {
    let archive = dir.join(ARCHIVE);
    if archive.is_file() { archive } else { dir }
}

fn mixed() -> Box<Refusal> {
    Box::new(Refusal {
        detail: "The upload has a ZIP file and other files.".to_owned(),
        hint: "Send either one ZIP file or photographs.".to_owned(),
        unsupported_format: false,
        is_ours: false,
        report: CaptureReport::default(),
    })
}

fn refuse(dir: &Path, error: CaptureError) -> Box<Refusal> {
    // Clients must not learn the server's paths.
    let archive = dir.join(ARCHIVE).display().to_string();
    let detail = error
        .to_string()
        .replace(&archive, "the upload")
        .replace(&dir.display().to_string(), "the upload");
    let hint = error.hint().to_owned();
    let is_ours = error.is_of_the_machine();
    let (accepted, assessments) = match error {
        CaptureError::TooFew { accepted, assessments } => (accepted, assessments),
        _ => (0, Vec::new()),
    };
    Box::new(Refusal {
        detail,
        hint,
        unsupported_format: assessments.iter().any(|assessment| assessment.unsupported_format),
        is_ours,
        report: CaptureReport {
            accepted: u32::try_from(accepted).unwrap_or(u32::MAX),
            images: assessments.into_iter().map(assessment).collect(),
            warnings: Vec::new(),
        },
    })
}

fn assessment(of: capture::Assessment) -> Assessment {
    Assessment {
        name: of.name,
        view: None,
        accepted: of.accepted,
        reason: of.reason,
        width: of.width,
        height: of.height,
        focal_px: of.focal_px,
        colours: of.colours,
        brightness: of.brightness,
        sharpness: of.sharpness,
        warnings: of.warnings.into_iter().map(warning).collect(),
    }
}

fn warning(of: CaptureWarning) -> Warning {
    Warning { code: of.code, message: of.message }
}
