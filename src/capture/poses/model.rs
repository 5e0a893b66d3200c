//! COLMAP's sparse models: cameras, images and points, as text or binary files.

mod binary;
mod camera;
mod rows;
mod text;

use std::path::{Path, PathBuf};

use super::{LeftOut, PoseFileError, left_out};

use camera::UnreadCamera;
pub use camera::{CameraModel, ModelCamera};
pub use rows::{ModelImage, ModelPoint, SparseModel};

impl SparseModel {
    /// Reads `cameras`, `images` and, if present, `points3D`, `.bin` or `.txt`; binary takes
    /// precedence if both exist. Files of newer versions (`rigs`, `frames`) repeat the content of a
    /// single-sensor model and are not read.
    ///
    /// # Errors
    /// [`PoseFileError::Io`] and [`PoseFileError::BadFile`]; a truncated file is an error, never a
    /// partial model, and so is an unusable row.
    pub fn read(dir: &Path) -> Result<Self, PoseFileError> {
        let (model, left_out) = Self::read_usable(dir)?;
        match left_out.is_empty() {
            true => Ok(model),
            false => Err(PoseFileError::bad_file(dir, left_out::in_words(&left_out))),
        }
    }

    /// As [`Self::read`], without the rows with unusable numbers or cameras, which are named.
    ///
    /// # Errors
    /// Those of [`Self::read`] for everything else.
    pub fn read_usable(dir: &Path) -> Result<(Self, Vec<LeftOut>), PoseFileError> {
        let is_binary = |name: &str| file(dir, &format!("{name}.bin")).is_file();
        let (mut model, unread) = if ["cameras", "images"].into_iter().all(is_binary) {
            binary::read(dir)
        } else {
            text::read(dir)
        }?;
        let left_out = model.keep_usable(dir, &unread)?;
        Ok((model, left_out))
    }

    /// Writes the three text files.
    ///
    /// # Errors
    /// [`PoseFileError::Io`].
    pub fn write_text(&self, dir: &Path) -> Result<(), PoseFileError> {
        text::write(self, dir)
    }

    /// The three text files, by name.
    pub fn text_files(&self) -> [(&'static str, String); 3] {
        text::files(self)
    }

    /// Writes the three binary files.
    ///
    /// # Errors
    /// [`PoseFileError::Io`].
    pub fn write_binary(&self, dir: &Path) -> Result<(), PoseFileError> {
        binary::write(self, dir)
    }

    /// Whether `dir` contains a model.
    pub fn stands_in(dir: &Path) -> bool {
        ["cameras.bin", "cameras.txt"].iter().any(|name| file(dir, name).is_file())
    }
}

/// A file of a model; if COLMAP's exact name is missing, any case is accepted.
fn file(dir: &Path, name: &str) -> PathBuf {
    let exact = dir.join(name);
    let is_it = |path: &PathBuf| path.file_name().is_some_and(|own| own.eq_ignore_ascii_case(name));
    let others = || dir.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    match exact.exists() {
        true => exact,
        false => others().find(is_it).unwrap_or(exact),
    }
}

/// The points of a model; none if the file is missing, as they can be triangulated.
fn points(
    dir: &Path,
    name: &str,
    read: impl Fn(&Path) -> Result<Vec<ModelPoint>, PoseFileError>,
) -> Result<Vec<ModelPoint>, PoseFileError> {
    let file = file(dir, name);
    match file.exists() {
        true => read(&file),
        false => Ok(Vec::new()),
    }
}

#[cfg(test)]
mod tests;
