//! Under which names an upload's files are stored: never where their own names say.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use fled_core::capture::video::is_video;

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
    /// Names as sent, to names as stored: ground truth follows its photograph.
    names: HashMap<String, String>,
    taken: HashSet<PathBuf>,
    /// The last number given to a path that was asked for more than once.
    numbers: HashMap<PathBuf, u32>,
}

impl Places {
    /// Where a file goes, relative to the capture: never where its name says.
    pub(super) fn place(&mut self, part: &str, name: &str) -> PathBuf {
        let components: Vec<&str> = name.split(['/', '\\']).filter(|c| !c.is_empty()).collect();
        let file = components.last().copied().unwrap_or("unnamed");
        let folder = components
            .len()
            .checked_sub(2)
            .and_then(|i| components.get(i))
            .copied()
            .unwrap_or_default();
        let lower = file.to_ascii_lowercase();
        let is_pose = ["transforms.json", "poses_bounds.npy"].contains(&lower.as_str());
        let is_model = ["cameras", "images", "points3d"]
            .iter()
            .any(|stem| lower == format!("{stem}.txt") || lower == format!("{stem}.bin"));
        if is_pose {
            return PathBuf::from(lower);
        }
        if is_model {
            // COLMAP's readers know these names only with their capitals.
            let name = if lower.starts_with("points3d") {
                lower.replace("points3d", "points3D")
            } else {
                lower
            };
            // Poses that others are measured with are not those of the capture, wherever a name
            // says that they lie.
            let is_truth = components
                .iter()
                .any(|component| component.eq_ignore_ascii_case(TRUE_POSES));
            return Path::new(if is_truth { TRUE_POSES } else { "sparse" }).join(name);
        }
        if lower.ends_with(".zip") && part != "gt" {
            return self.unique(Path::new(""), validation::ARCHIVE);
        }
        if is_video(Path::new(&lower)) && part == PHOTOGRAPHS {
            return self.unique(Path::new(VIDEOS), &safe_name(file));
        }
        let is_truth = part == "gt"
            || ["gt", "hl"]
                .iter()
                .any(|truth| folder.eq_ignore_ascii_case(truth));
        let stored = match self.names.get(file) {
            // The second of a pair takes the name of the first.
            Some(stored) if !self.taken.contains(&folder_of(is_truth).join(stored)) => {
                stored.clone()
            }
            _ => safe_name(file),
        };
        let path = self.unique(&folder_of(is_truth), &stored);
        if let Some(stored) = path.file_name().and_then(|name| name.to_str()) {
            self.names.insert(file.to_owned(), stored.to_owned());
        }
        path
    }

    /// A path that is not taken. Numbers only grow, so that thousands of equal names cost no more
    /// than different ones.
    fn unique(&mut self, folder: &Path, name: &str) -> PathBuf {
        let first = folder.join(name);
        if self.taken.insert(first.clone()) {
            return first;
        }
        let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
        let number = self.numbers.entry(first).or_insert(1);
        loop {
            *number += 1;
            let path = folder.join(format!("{stem}-{number}.{extension}"));
            if self.taken.insert(path.clone()) {
                return path;
            }
        }
    }
}

fn folder_of(is_truth: bool) -> PathBuf {
    PathBuf::from(if is_truth { "gt" } else { PHOTOGRAPHS })
}

/// The file name without what harms disks, command lines or logs. Otherwise as it was: poses that
/// come with a capture call its photographs by their names.
fn safe_name(name: &str) -> String {
    let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
    let keep = |text: &str, most: usize| -> String {
        let mut bytes = 0;
        text.chars()
            .map(|c| {
                if c.is_control() || "/\\:*?\"<>|".contains(c) {
                    '_'
                } else {
                    c
                }
            })
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
mod tests {
    use super::*;

    #[test]
    fn no_name_leaves_its_folder_or_reaches_a_command_line() {
        for name in [
            "../../etc/passwd",
            "-rf.png",
            "a\nb.jpg",
            "日本.png",
            ".hidden",
            "",
            "x".repeat(300).as_str(),
        ] {
            let safe = safe_name(name);
            assert!(
                !safe.starts_with(['-', '.']) && safe.len() <= 161 && !safe.is_empty(),
                "{name:?} -> {safe:?}"
            );
            assert!(
                !safe.contains(['/', '\\', '\n', '\0']),
                "{name:?} -> {safe:?}"
            );
        }
        assert_eq!(safe_name("IMG 0001.JPG"), "IMG 0001.JPG");
    }

    #[test]
    fn true_poses_are_not_taken_for_those_of_the_capture() {
        let mut places = Places::default();
        for (name, place) in [
            ("fern/sparse/0/images.txt", "sparse/images.txt"),
            ("fern/sparse_gt/images.txt", "sparse_gt/images.txt"),
            ("fern/sparse_gt/0/Points3D.txt", "sparse_gt/points3D.txt"),
            ("cameras.bin", "sparse/cameras.bin"),
        ] {
            assert_eq!(places.place("images", name), Path::new(place), "{name}");
        }
    }

    #[test]
    fn equal_names_by_the_thousand_cost_no_more_than_different_ones() {
        let mut places = Places::default();
        let start = std::time::Instant::now();
        let paths: HashSet<PathBuf> = (0..20_000)
            .map(|_| places.place("images", "photograph.jpg"))
            .collect();
        assert_eq!(paths.len(), 20_000);
        assert!(paths.contains(Path::new("images/photograph-20000.jpg")));
        assert!(
            start.elapsed() < std::time::Duration::from_secs(2),
            "{:?}",
            start.elapsed()
        );
    }
}
