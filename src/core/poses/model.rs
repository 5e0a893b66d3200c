//! COLMAP's sparse models: cameras, images and points, as text or binary files.

mod binary;
mod camera;
mod rows;
mod text;

use std::path::Path;

use super::PosesError;

pub use camera::{CameraModel, ModelCamera};
pub use rows::{ModelImage, ModelPoint, SparseModel};

impl SparseModel {
    /// Reads `cameras`, `images` and `points3D`, `.bin` or `.txt`; binary wins where both stand.
    /// Files of newer versions (`rigs`, `frames`) repeat what a single-sensor model says already
    /// and are not read.
    ///
    /// # Errors
    /// [`PosesError::Io`] and [`PosesError::BadFile`]; a file cut short is an error, never a short
    /// model.
    pub fn read(dir: &Path) -> Result<Self, PosesError> {
        let model = if dir.join("cameras.bin").is_file() {
            binary::read(dir)
        } else {
            text::read(dir)
        }?;
        model.check(dir)?;
        Ok(model)
    }

    /// Writes the three text files.
    ///
    /// # Errors
    /// [`PosesError::Io`].
    pub fn write_text(&self, dir: &Path) -> Result<(), PosesError> {
        text::write(self, dir)
    }

    /// The three text files, by name.
    pub fn text_files(&self) -> [(&'static str, String); 3] {
        text::files(self)
    }

    /// Writes the three binary files.
    ///
    /// # Errors
    /// [`PosesError::Io`].
    pub fn write_binary(&self, dir: &Path) -> Result<(), PosesError> {
        binary::write(self, dir)
    }

    /// Whether `dir` holds a model.
    pub fn stands_in(dir: &Path) -> bool {
        ["cameras.bin", "cameras.txt"]
            .iter()
            .any(|name| dir.join(name).is_file())
    }
}

#[cfg(test)]
mod tests;
