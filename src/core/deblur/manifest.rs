//! The networks that fled knows: `models/manifest.json` of this build, with the user's own laid
//! over it.

mod entry;
mod files;
mod model;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::deblur::DeblurError;
use crate::deblur::choice::DEFAULT;
use files::read;

pub use crate::inference::digest;
pub use entry::{Entry, Role};
pub use files::Place;
pub use model::Model;

const MANIFEST: &str = include_str!("../../../models/manifest.json");

/// The user's entries, in each folder of models.
pub const OVERLAY: &str = "manifest.json";

/// All known networks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// In the order of the file.
    pub models: Vec<Entry>,
}

impl Manifest {
    /// The manifest of this build.
    pub fn embedded() -> Self {
        serde_json::from_str(MANIFEST).expect("a test reads the embedded manifest")
    }

    /// The manifest of this build with the overlays of `directories` over it: an entry takes the
    /// place of the one with its id, or is added; the last one that calls itself the default is it.
    ///
    /// # Errors
    /// [`DeblurError::ManifestUnreadable`] when an overlay is there and cannot be read.
    pub fn known(directories: &[PathBuf]) -> Result<Self, DeblurError> {
        let mut manifest = Self::embedded();
        for directory in directories {
            for entry in Self::overlay(directory)?.models {
                manifest.lay_over(entry);
            }
            if manifest.find(DEFAULT).is_none() {
                let detail =
                    "no network is the default any more: one entry needs `\"default\": true`"
                        .to_owned();
                return Err(DeblurError::ManifestUnreadable {
                    path: directory.join(OVERLAY),
                    detail,
                });
            }
        }
        Ok(manifest)
    }

    /// The user's entries in one folder; none without the file.
    ///
    /// # Errors
    /// [`DeblurError::ManifestUnreadable`].
    pub fn overlay(directory: &Path) -> Result<Self, DeblurError> {
        let path = directory.join(OVERLAY);
        let unreadable = |detail: String| DeblurError::ManifestUnreadable {
            path: path.clone(),
            detail,
        };
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Self::default());
            }
            Err(error) => return Err(unreadable(error.to_string())),
        };
        let overlay: Self =
            serde_json::from_str(&text).map_err(|error| unreadable(error.to_string()))?;
        overlay
            .models
            .iter()
            .try_for_each(|entry| entry.check().map_err(&unreadable))?;
        Ok(overlay)
    }

    /// Puts `entry` in the place of the one with its id, or adds it.
    pub fn lay_over(&mut self, entry: Entry) {
        if entry.default {
            self.models
                .iter_mut()
                .for_each(|other| (other.default, other.default_on_cuda) = (false, false));
        }
        if entry.default_on_cuda {
            self.models
                .iter_mut()
                .for_each(|other| other.default_on_cuda = false);
        }
        match self.models.iter_mut().find(|other| other.id == entry.id) {
            Some(place) => *place = entry,
            None => self.models.push(entry),
        }
    }

    /// The entry that `choice` means: `default` or an id.
    pub fn find(&self, choice: &str) -> Option<&Entry> {
        self.models
            .iter()
            .find(|entry| entry.id == choice || (choice == DEFAULT && entry.default))
    }

    /// The entry that `default` means where CUDA runs it; none once the user has a default of their
    /// own.
    pub fn default_on_cuda(&self) -> Option<&Entry> {
        self.models.iter().find(|entry| entry.default_on_cuda)
    }

    /// The networks that may be chosen without naming a file: `default` and the ids.
    pub fn choices(&self) -> Vec<&str> {
        let ids = self.models.iter().map(|entry| entry.id.as_str());
        std::iter::once(DEFAULT).chain(ids).collect()
    }

    /// The network that `choice` means: `default`, an id, or the path of an ONNX file. Files of
    /// known networks that are not built in are looked for in `directories`.
    ///
    /// # Errors
    /// [`DeblurError::UnknownModel`], [`DeblurError::ModelFileMissing`],
    /// [`DeblurError::ModelUnreadable`] or [`DeblurError::ModelChecksum`].
    pub fn resolve(&self, choice: &str, directories: &[PathBuf]) -> Result<Model, DeblurError> {
        if let Some(entry) = self.find(choice) {
            return entry.load(directories);
        }
        let path = Path::new(choice);
        if path.is_file() {
            return self.by_path(path, directories);
        }
        let known = self
            .models
            .iter()
            .map(|entry| entry.id.as_str())
            .collect::<Vec<_>>()
            .join(", ");
        Err(DeblurError::UnknownModel {
            choice: choice.to_owned(),
            known,
        })
    }

    /// A file named by its path: a known network if its checksum says so, else taken as it is.
    fn by_path(&self, path: &Path, directories: &[PathBuf]) -> Result<Model, DeblurError> {
        let bytes = read(path)?;
        let sha256 = digest(&bytes);
        if let Some(entry) = self
            .models
            .iter()
            .find(|entry| entry.sha256.as_ref() == Some(&sha256))
        {
            return entry.checked(bytes, entry.golden_file(directories)?.as_deref());
        }
        let id = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        Ok(Model::unknown(id, bytes))
    }
}

#[cfg(test)]
mod tests;
