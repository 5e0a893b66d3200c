//! The output folder of a run: the place of every artifact, each written atomically.

use std::path::Path;
use std::{fs, io};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::error::PipelineError;
use crate::capture::Capture;
use crate::image::write_atomic;
use crate::run_folder::RunFolder;

/// Version of the code that makes artifacts. Raise it when a stage's result changes for equal
/// inputs: a rerun then repeats the stage instead of trusting the artifacts on disk, and cached
/// poses, renders and frames of videos are made again. Golden runs cannot be blessed otherwise.
pub const CODE_VERSION: u32 = 13;

/// The output folder of one run. Cheap to clone; holds paths only.
#[derive(Clone, Debug)]
pub struct Workspace {
    folder: RunFolder,
}

/// The mark that a finished stage leaves: its artifacts are valid for these inputs only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Stamp {
    fingerprint: String,
    seconds: f64,
}

impl Workspace {
    /// Opens a folder, and creates it if it does not exist.
    ///
    /// # Errors
    /// [`PipelineError::Io`] when it cannot be created.
    pub fn open(root: &Path) -> Result<Self, PipelineError> {
        fs::create_dir_all(root).map_err(|e| PipelineError::io(root, e))?;
        Ok(Self { folder: RunFolder::new(root) })
    }

    /// The paths in the folder.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// Removes the prepared images of the capture, some 17 MB a photograph, but not photographs
    /// taken from a video: a later run prepares them again in seconds.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn discard_prepared(&self) -> Result<(), PipelineError> {
        Ok(Capture::discard(&self.folder.work().prepared())?)
    }

    /// Removes files that only serve a later run into the same folder with other options: the
    /// prepared capture, the networks' results and the checkpoint.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn discard_intermediates(&self) -> Result<(), PipelineError> {
        for path in self.folder.work().disposable() {
            let gone =
                if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            match gone {
                Err(e) if e.kind() != io::ErrorKind::NotFound => {
                    return Err(PipelineError::io(&path, e));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Creates a folder and its parents.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn make_folder(&self, path: &Path) -> Result<(), PipelineError> {
        fs::create_dir_all(path).map_err(|e| PipelineError::io(path, e))
    }

    /// Removes a file, if it exists.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn remove(&self, path: &Path) -> Result<(), PipelineError> {
        match fs::remove_file(path) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => Err(PipelineError::io(path, e)),
            _ => Ok(()),
        }
    }

    /// Writes a file under a temporary name, syncs it and renames it.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), PipelineError> {
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(|e| PipelineError::io(parent, e))?;
        }
        write_atomic(path, bytes).map_err(|e| PipelineError::io(path, e))
    }

    /// Writes a value as indented JSON, atomically.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn write_json(&self, path: &Path, value: &impl Serialize) -> Result<(), PipelineError> {
        let mut bytes =
            serde_json::to_vec_pretty(value).map_err(|e| PipelineError::io(path, e.into()))?;
        bytes.push(b'\n');
        self.write(path, &bytes)
    }

    /// Reads a JSON file; `None` when it is absent or from another version.
    pub fn read_json<T: DeserializeOwned>(&self, path: &Path) -> Option<T> {
        serde_json::from_slice(&fs::read(path).ok()?).ok()
    }

    /// Notes that this build works here; returns whether another version of the code did before,
    /// whose results are not used.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn enter(&self) -> Result<bool, PipelineError> {
        let path = self.folder.work().code_version();
        let before: Option<u32> = self.read_json(&path);
        if before != Some(CODE_VERSION) {
            self.write_json(&path, &CODE_VERSION)?;
        }
        // Versions before 8 left stamps alone.
        let has_stamps = self.folder.work().stamps().is_dir();
        Ok(before.map_or(has_stamps, |before| before != CODE_VERSION))
    }

    /// Marks the stage `name` as finished for inputs of this fingerprint.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn stamp(&self, name: &str, fingerprint: &str, seconds: f64) -> Result<(), PipelineError> {
        let stamp = Stamp { fingerprint: fingerprint.to_owned(), seconds };
        self.write_json(&self.folder.work().stamp(name), &stamp)
    }

    /// Removes the mark before the stage's artifacts are overwritten.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn unstamp(&self, name: &str) -> Result<(), PipelineError> {
        self.remove(&self.folder.work().stamp(name))
    }

    /// Seconds that the stage took, if it finished for inputs of this fingerprint.
    pub fn finished(&self, name: &str, fingerprint: &str) -> Option<f64> {
        let stamp: Stamp = self.read_json(&self.folder.work().stamp(name))?;
        (stamp.fingerprint == fingerprint).then_some(stamp.seconds)
    }
}

/// Hash of the parts, prefixed with [`CODE_VERSION`]: the name or the stamp of anything that
/// outlives the build that made it.
pub fn fingerprint(parts: &[&str]) -> String {
    fingerprint_by(CODE_VERSION, parts)
}

fn fingerprint_by(version: u32, parts: &[&str]) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&version.to_le_bytes());
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_is_valid_for_its_own_inputs_only() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let workspace = Workspace::open(folder.path()).expect("open");
        assert_eq!(workspace.finished("poses", "a"), None);
        workspace.stamp("poses", "a", 2.5).expect("stamp");
        assert_eq!(workspace.finished("poses", "a"), Some(2.5));
        assert_eq!(workspace.finished("poses", "b"), None);
    }

    #[test]
    fn a_fingerprint_separates_its_parts() {
        assert_ne!(fingerprint(&["ab", "c"]), fingerprint(&["a", "bc"]));
        assert_eq!(fingerprint(&["ab", "c"]), fingerprint(&["ab", "c"]));
    }

    #[test]
    fn a_run_of_another_version_is_recognised_once() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let workspace = Workspace::open(folder.path()).expect("open");
        assert!(!workspace.enter().expect("entered"), "a new run");
        workspace.stamp("render", "f", 1.0).expect("stamped");
        assert!(!workspace.enter().expect("entered"), "the same version");
        let version = workspace.folder().work().code_version();
        for older in [Some(CODE_VERSION - 1), None] {
            match older {
                Some(older) => workspace.write_json(&version, &older).expect("written"),
                None => workspace.remove(&version).expect("removed"),
            }
            assert!(workspace.enter().expect("entered"), "{older:?}");
            assert!(!workspace.enter().expect("entered"), "it was reported");
        }
    }

    #[test]
    fn another_code_version_makes_another_fingerprint() {
        let by = |version| fingerprint_by(version, &["ab", "c"]);
        assert_ne!(by(CODE_VERSION), by(CODE_VERSION - 1));
        assert_eq!(by(CODE_VERSION), fingerprint(&["ab", "c"]));
    }
}
