//! The masks that frames name.

use std::path::Path;

use serde_json::Value;

use super::{files, json};
use crate::photo_path::PhotoPath;
use crate::poses::PoseFileError;

/// Nerfstudio's field for the mask of a frame, relative to the file.
const FIELD: &str = "mask_path";

/// The photographs and masks of the frames that have one, with their paths in the file, including
/// the other splits beside it.
///
/// # Errors
/// [`PoseFileError`] if a file cannot be read.
pub fn masks(file: &Path) -> Result<Vec<(PhotoPath, PhotoPath)>, PoseFileError> {
    let mut all = Vec::new();
    for (file, _) in files(file)? {
        let content = json::read(&file)?;
        let frames = content.get("frames").and_then(Value::as_array);
        let text =
            |frame: &Value, key: &str| frame.get(key).and_then(Value::as_str).map(PhotoPath::new);
        let masked = |frame: &Value| Some((text(frame, "file_path")?, text(frame, FIELD)?));
        all.extend(frames.into_iter().flatten().filter_map(masked));
    }
    Ok(all)
}
