//! Under which names an upload's files are stored: never where their own names say.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};

use fled_core::capture::video::is_video;
use fled_core::photo_path::PhotoPath;

use crate::http::problem::Problem;
use crate::validation;

/// Folder of the photographs.
pub(super) const PHOTOGRAPHS: &str = "images";
/// Folder of the videos that photographs are taken of.
pub(super) const VIDEOS: &str = "video";

/// Folder of a model that poses are measured with.
const TRUE_POSES: &str = "sparse_gt";

/// The names of one upload.
#[derive(Debug, Default)]
pub(super) struct Places {
    /// What the sender calls the files, by where they are stored.
    names: BTreeMap<String, PhotoPath>,
    /// Whether that differs.
    differs: bool,
    taken: HashSet<PathBuf>,
    /// The last number given to a path that was asked for more than once.
    numbers: HashMap<PathBuf, u32>,
    /// Where poses are stored, by the folder they should lie in and that they were sent from.
    poses: HashMap<(&'static str, String), PathBuf>,
}

impl Places {
    /// Where a file goes, relative to the capture: never where its name says. What it is called is
    /// kept beside.
    ///
    /// # Errors
    /// 422 for a second file of poses of the same name: two models would become one.
    pub(super) fn place(&mut self, part: &str, name: &str) -> Result<PathBuf, Problem> {
        let path = sent_path(part, name);
        let lower = path.name().to_ascii_lowercase();
        if lower.ends_with(".zip") && part != "gt" {
            return Ok(self.unique(Path::new(""), validation::ARCHIVE));
        }
        if is_video(Path::new(&lower)) && part == PHOTOGRAPHS {
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
                // COLMAP's readers know these names only with their capitals.
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

    /// The content of [`fled_core::capture::NAMES`], where the places do not say it.
    pub(super) fn names(&self) -> Option<String> {
        self.differs.then(|| serde_json::json!(self.names).to_string())
    }

    /// A path that is not taken. Numbers only grow, so that thousands of equal names cost no more
    /// than different ones.
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

fn sent_twice(path: &PhotoPath) -> Problem {
    Problem::unprocessable("bad_input", format!("`{path}` is sent twice."))
        .hint("Send one file of this name, or each with its folder, as in `sparse/0/images.txt`.")
}

/// What a file is called inside the capture. A path from the root of another machine says nothing
/// but its last part; poses without a folder and ground truth lie where they are looked for.
fn sent_path(part: &str, name: &str) -> PhotoPath {
    // `C:\` and `C:/` begin at a drive; a colon elsewhere belongs to the name of a folder.
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

/// The folder of the capture that a file of poses belongs in.
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
    // Poses that others are measured with are not those of the capture, wherever a name says that
    // they lie.
    let is_truth = path.lies_in(&[TRUE_POSES]);
    is_model.then_some(if is_truth { TRUE_POSES } else { "sparse" })
}

/// The file name without what harms disks, command lines or logs. Otherwise as it was: poses that
/// come with a capture call its photographs by their names.
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
