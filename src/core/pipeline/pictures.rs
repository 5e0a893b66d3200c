//! Pictures for people; metrics never read them.

use std::path::Path;

use super::error::PipelineError;
use super::workspace::Workspace;
use crate::image::{EncodeFormat, Image};

/// JPEG quality of pictures that are viewed and not measured.
const PREVIEW_QUALITY: u8 = 90;

/// Writes a picture atomically.
///
/// # Errors
/// [`PipelineError::Photograph`], [`PipelineError::Io`].
pub fn write(
    workspace: &Workspace,
    path: &Path,
    image: &Image,
    format: EncodeFormat,
) -> Result<(), PipelineError> {
    let unencodable =
        |source| PipelineError::Photograph { name: path.display().to_string(), source };
    let bytes = image.encode(format).map_err(unencodable)?;
    workspace.write(path, &bytes)
}

/// Writes a picture for viewing.
///
/// # Errors
/// As [`write`].
pub fn preview(workspace: &Workspace, path: &Path, image: &Image) -> Result<(), PipelineError> {
    write(workspace, path, image, EncodeFormat::Jpeg(PREVIEW_QUALITY))
}
