//! Validation of an upload with the pipeline's own capture reader.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use fled_core::capture::{
    self, ASSESSED_SIDE, Assessment, Capture, CaptureError, CaptureWarning, Placement, Watch,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::schema::ArrayBuilder;
use utoipa::openapi::{Array, Ref};

use crate::redaction::without_paths;

/// The name under which an uploaded zip is stored.
pub const ARCHIVE: &str = "upload.zip";

/// The assessments of an upload.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CaptureReport {
    /// Number of usable photographs.
    pub accepted: u32,
    /// One assessment per file.
    #[schema(schema_with = assessments)]
    pub images: Vec<Assessment>,
    /// Warnings about the whole capture.
    #[schema(schema_with = warnings)]
    pub warnings: Vec<CaptureWarning>,
}

/// The schema of assessments, which the document has from the core.
fn assessments() -> Array {
    list("Assessment", "One assessment per file.")
}

/// The schema of warnings, which the document has from the core.
pub fn warnings() -> Array {
    list("Warning", "Warnings about the whole capture.")
}

fn list(of: &str, description: &str) -> Array {
    let list = ArrayBuilder::new().items(Ref::from_schema_name(of));
    list.description(Some(description)).build()
}

/// Why an upload is no usable capture.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Refusal {
    /// What is wrong.
    pub detail: String,
    /// What to do about it.
    pub hint: String,
    /// Whether photographs in an unsupported format are the reason.
    pub unsupported_format: bool,
    /// Whether the machine is at fault, not the upload.
    pub is_ours: bool,
    /// Whether the disk is full.
    pub is_full: bool,
    /// The assessments so far.
    pub report: CaptureReport,
}

/// Validates the content of `dir`, a single archive or the files of a capture folder, by preparing
/// it as a job does, with small images that are removed again. A zip stays packed, because only
/// inside it do its files have their names. It decodes untrusted files, so call it only in a
/// process that may die.
///
/// # Errors
/// [`Refusal`] if it is no usable capture.
pub fn examine(dir: &Path, watch: &Watch<'_>) -> Result<CaptureReport, Box<Refusal>> {
    let source = source(dir.to_owned());
    if source != dir && dir.read_dir().is_ok_and(|entries| entries.count() > 1) {
        return Err(mixed());
    }
    let scratch = dir.join(".examined");
    let opened = Capture::prepare(&source, &scratch, ASSESSED_SIDE, watch);
    match fs::remove_dir_all(&scratch) {
        Err(source) if source.kind() != ErrorKind::NotFound => {
            return Err(refuse(dir, CaptureError::Io { path: scratch, source }));
        }
        _ => {}
    }
    let capture = opened.map_err(|error| refuse(dir, error))?;
    let report = report(capture.views.len(), capture.assessments);
    match capture.poses.map(|poses| poses.placement) {
        Some(Placement::Unusable { file, reason }) => Err(Box::new(Refusal {
            detail: without_paths(&format!("The poses cannot be read: {file}: {reason}")),
            hint: "Fix the file, or leave it out: then fled finds the poses.".to_owned(),
            report,
            ..Refusal::default()
        })),
        _ => Ok(CaptureReport { warnings: capture.warnings, ..report }),
    }
}

fn report(accepted: usize, images: Vec<Assessment>) -> CaptureReport {
    let accepted = u32::try_from(accepted).unwrap_or(u32::MAX);
    CaptureReport { accepted, images, warnings: Vec::new() }
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

/// Most bytes of the small images that are made of the files in `dir`, and then removed.
pub fn image_bytes(dir: &Path) -> u64 {
    6 * (ASSESSED_SIDE * ASSESSED_SIDE) as u64 * files_below(dir)
}

/// The number of files in a folder and below it; what cannot be read has none.
fn files_below(dir: &Path) -> u64 {
    let entries = dir.read_dir().into_iter().flatten().flatten();
    entries.map(|entry| if entry.path().is_dir() { files_below(&entry.path()) } else { 1 }).sum()
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
        ..Refusal::default()
    })
}

fn refuse(dir: &Path, error: CaptureError) -> Box<Refusal> {
    // Clients must not learn the server's paths.
    let archive = dir.join(ARCHIVE).display().to_string();
    let detail = error
        .to_string()
        .replace(&archive, "the upload")
        .replace(&dir.display().to_string(), "the upload");
    let refusal = Refusal {
        detail,
        hint: error.hint().to_owned(),
        is_ours: error.is_of_the_machine(),
        is_full: error.is_full(),
        ..Refusal::default()
    };
    Box::new(match error {
        CaptureError::TooFew { accepted, assessments } => Refusal {
            unsupported_format: assessments.iter().any(|one| one.unsupported_format),
            report: report(accepted, assessments),
            ..refusal
        },
        _ => refusal,
    })
}
