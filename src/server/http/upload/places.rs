//! The names under which an upload's files are stored, which the client does not choose.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};

use fled_core::capture::video::is_video;
use fled_core::photo_path::PhotoPath;

use crate::http::problem::Problem;
use crate::validation;

/// Folder of the photographs.
pub(super) const PHOTOGRAPHS: &str = "images";
/// Folder of the videos that photographs are taken from.
pub(super) const VIDEOS: &str = "video";

/// Folder of a model for evaluating poses.
const TRUE_POSES: &str = "sparse_gt";

/// The names of one upload.
#[derive(Debug, Default)]
pub(super) struct Places {
    /// The files' original names, by where they are stored.
    names: BTreeMap<String, PhotoPath>,
    /// Whether any of them differ.
    differs: bool,
    taken: HashSet<PathBuf>,
    /// The last number added to a path that was requested more than once.
    numbers: HashMap<PathBuf, u32>,
    /// Where poses are stored, by their target folder and the folder they were sent from.
    poses: HashMap<(&'static str, String), PathBuf>,
}

impl Places {
    /// Where a file is stored, relative to the capture: never at its original path. The original
    /// name is recorded separately.
    ///
    /// # Errors
    /// 422 for a second pose file of the same name: two models would be merged.
    pub(super) fn place(&mut self, part: &str, name: &str) -> Result<PathBuf, Problem> {
        let path = sent_path(part, name);
        let lower = path.name().to_ascii_lowercase();
        if is_archive(&path) && part != "gt" {
            return Ok(self.unique(Path::new(""), validation::ARCHIVE));
        }
        if is_video(Path::new(path.name())) && part == PHOTOGRAPHS {
            return Ok(self.unique(Path::new(VIDEOS), &safe_name(path.name())));
        }
        let place = match folder_of_poses(&path) {
            Some(folder) => {
                let source = path.folder().to_owned();
                let folder = match self.poses.get(&(folder, source.clone())) {
                    Some(folder) => folder.clone(),
                    None => {
                        let own = match folder {
                            "" if self.taken.insert(PathBuf::new()) => PathBuf::new(),
                            "" => self.unique(Path::new(""), "poses"),
                            folder => self.unique(Path::new(""), folder),
                        };
                        self.poses.insert((folder, source), own.clone());
                        own
                    }
                };
                // COLMAP's readers expect these names with their capitals.
                let place = folder.join(lower.replace("points3d", "points3D"));
                if self.names.contains_key(&*place.to_string_lossy()) {
                    return Err(sent_twice(&path));
                }
                place
            }
            None => {
                let folder = if path.lies_in(&["gt", "hl"]) { "gt" } else { PHOTOGRAPHS };
                self.unique(Path::new(folder), &safe_name(path.name()))
            }
        };
        let stored = place.to_string_lossy().into_owned();
        let plain = [path.as_str().to_owned(), format!("{PHOTOGRAPHS}/{path}")];
        self.differs |= !plain.contains(&stored);
        self.names.insert(stored, path);
        Ok(place)
    }

    /// The content of [`fled_core::capture::NAMES`]; `None` if all files have their original names.
    pub(super) fn names(&self) -> Option<String> {
        self.differs.then(|| serde_json::json!(self.names).to_string())
    }

    /// A free path. Numbers only grow, so thousands of equal names cost no more than different
    /// ones.
    fn unique(&mut self, folder: &Path, name: &str) -> PathBuf {
        let first = folder.join(name);
        if self.taken.insert(first.clone()) {
            return first;
        }
        let end = name.rfind('.').unwrap_or(name.len());
        let (stem, extension) = name.split_at(end);
        let number = self.numbers.entry(first).or_insert(1);
        loop {
            *number += 1;
            let path = folder.join(format!("{stem}-{number}{extension}"));
            if self.taken.insert(path.clone()) {
                return path;
            }
        }
    }
}

/// Whether a file is stored as the ZIP of an upload, wherever photographs are expected.
pub(super) fn is_archive(path: &PhotoPath) -> bool {
    path.name().to_ascii_lowercase().ends_with(".zip")
}

fn sent_twice(path: &PhotoPath) -> Problem {
    Problem::unprocessable("bad_input", format!("`{path}` is sent twice."))
        .hint("Send one file of this name, or each with its folder, as in `sparse/0/images.txt`.")
}

/// A file's name inside the capture. Of an absolute path from another machine only the last part is
/// used; poses without a folder and ground truth get the folders where they are expected.
fn sent_path(part: &str, name: &str) -> PhotoPath {
    // `C:\` and `C:/` begin with a drive; a colon elsewhere is part of a folder name.
    let after_drive = name
        .strip_prefix(|c: char| c.is_ascii_alphabetic())
        .and_then(|rest| rest.strip_prefix(':'));
    let is_absolute = after_drive.unwrap_or(name).starts_with(['/', '\\']);
    let path = PhotoPath::new(name);
    let path = if is_absolute { PhotoPath::new(path.name()) } else { path };
    let is_flat = path.folder().is_empty();
    match folder_of_poses(&path) {
        Some(folder) if is_flat => path.inside(folder),
        None if part == "gt" && !path.lies_in(&["gt", "hl"]) => path.inside("gt"),
        _ if path.as_str().is_empty() => PhotoPath::new("unnamed"),
        _ => path,
    }
}

/// The folder of the capture for a pose file.
fn folder_of_poses(path: &PhotoPath) -> Option<&'static str> {
    let name = path.name().to_ascii_lowercase();
    let flat = [
        "transforms.json",
        "transforms_train.json",
        "transforms_val.json",
        "transforms_test.json",
        "poses_bounds.npy",
    ];
    if flat.contains(&&*name) {
        return Some("");
    }
    let is_model = ["cameras", "images", "points3d"]
        .iter()
        .any(|stem| name == format!("{stem}.txt") || name == format!("{stem}.bin"));
    // Ground-truth poses are not the capture's own, in whatever folder a name puts them.
    let is_truth = path.lies_in(&[TRUE_POSES]);
    is_model.then_some(if is_truth { TRUE_POSES } else { "sparse" })
}

/// The file name without characters that harm disks, command lines or logs. The rest is unchanged,
/// because poses sent with a capture refer to its photographs by name.
fn safe_name(name: &str) -> String {
    let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
    let keep = |text: &str, most: usize| -> String {
        let mut bytes = 0;
        text.chars()
            .map(|c| if c.is_control() || "/\\:*?\"<>|".contains(c) { '_' } else { c })
            .take_while(|c| {
                bytes += c.len_utf8();
                bytes <= most
            })
            .collect()
    };
    let stem = keep(stem, 150);
    let stem = stem.trim_start_matches(['-', '.', ' ']);
    let stem = if stem.is_empty() { "photograph" } else { stem };
    match keep(extension, 10) {
        extension if extension.is_empty() => stem.to_owned(),
        extension => format!("{stem}.{extension}"),
    }
}

#[cfg(test)]
mod tests;
