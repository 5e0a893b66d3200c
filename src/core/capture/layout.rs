//! Which file of a capture is what.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::{Path, PathBuf};

use crate::image::{Unread, named_like_a_photograph};

use super::entries::{Entry, natural};
use super::error::CaptureError;
use super::video::is_video;

/// Folders that mean something; none of them is a wrapper around the capture.
const KNOWN_FOLDERS: [&str; 5] = ["images", "gt", "hl", "sparse", "sparse_gt"];

/// Poses that came with the capture, by the format of their file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GivenPosesFile {
    /// The folder of a COLMAP model: `cameras`, `images` and `points3D`, as text or binary.
    ColmapModel(PathBuf),
    /// NeRF's `transforms.json`.
    Transforms(PathBuf),
    /// LLFF's `poses_bounds.npy`.
    PosesBounds(PathBuf),
}

impl GivenPosesFile {
    /// The folder or file.
    pub fn path(&self) -> &Path {
        match self {
            Self::ColmapModel(path) | Self::Transforms(path) | Self::PosesBounds(path) => path,
        }
    }
}

/// A capture's files by their role.
#[derive(Debug)]
pub(super) struct Layout {
    /// What claims to be a photograph, in natural order.
    pub(super) photographs: Vec<Entry>,
    /// Videos and archives beside them: listed, not used.
    pub(super) unused: Vec<Entry>,
    /// Ground truth by lower-case stem; empty when there is none.
    pub(super) ground_truth: BTreeMap<String, Entry>,
    /// Poses.
    pub(super) poses: Option<GivenPosesFile>,
    /// The files that hold the poses, for the fingerprint.
    pose_files: Vec<Entry>,
    /// Every how many-th photograph the capture itself holds out.
    pub(super) hold: Option<u32>,
}

impl Layout {
    pub(super) fn of(mut entries: Vec<Entry>) -> Self {
        strip_wrappers(&mut entries);
        entries.sort_by(|a, b| natural(&a.path, &b.path));
        let inside = |entry: &Entry, folder: &str| entry.folder().eq_ignore_ascii_case(folder);
        let photographs_in = |folder: &str| -> Vec<Entry> {
            entries
                .iter()
                .filter(|e| inside(e, folder) && claims_to_be_a_photograph(e))
                .cloned()
                .collect()
        };
        let with_folder = photographs_in("images");
        let photographs = if with_folder.is_empty() {
            photographs_in("")
        } else {
            with_folder
        };
        let beside = match photographs.first() {
            Some(first) => vec![first.folder()],
            None => vec!["", "images"],
        };
        let is_unused = |entry: &&Entry| {
            let path = Path::new(&entry.path);
            beside.iter().any(|folder| inside(entry, folder))
                && !named_like_a_photograph(path)
                && (is_video(path) || Unread::named(path).is_some())
        };
        let unused = entries.iter().filter(is_unused).cloned().collect();
        let truth = photographs_in("gt");
        let truth = if truth.is_empty() {
            photographs_in("hl")
        } else {
            truth
        };
        let ground_truth = truth
            .into_iter()
            .map(|e| (e.stem().to_lowercase(), e))
            .collect();
        let hold = entries.iter().find_map(|e| hold(&e.path));
        let (poses, pose_files) = find_poses(&entries);
        Self {
            photographs,
            unused,
            ground_truth,
            poses,
            pose_files,
            hold,
        }
    }

    /// blake3 over the names and contents of everything that plays a role.
    pub(super) fn fingerprint(&self) -> Result<String, CaptureError> {
        let mut hasher = blake3::Hasher::new();
        let truth = self.ground_truth.values();
        for entry in self.photographs.iter().chain(truth).chain(&self.pose_files) {
            let file = File::open(&entry.file).map_err(CaptureError::io(&entry.file))?;
            let mut content = blake3::Hasher::new();
            content
                .update_reader(file)
                .map_err(CaptureError::io(&entry.file))?;
            // The length keeps a name and what follows it apart.
            hasher.update(&(entry.path.len() as u64).to_le_bytes());
            hasher.update(entry.path.as_bytes());
            hasher.update(content.finalize().as_bytes());
        }
        if let Some(hold) = self.hold {
            hasher.update(format!("{HOLD}{hold}").as_bytes());
        }
        Ok(hasher.finalize().to_hex().to_string())
    }
}

/// How the name of the file begins that says it, as the sets of Deblur-NeRF and ExBluRF have it.
const HOLD: &str = "hold=";

/// What an entry says about which photographs are held out: every n-th, from the first. Nothing is
/// left to train on below 2.
pub(super) fn hold(path: &str) -> Option<u32> {
    let number = path.strip_prefix(HOLD)?.parse().ok()?;
    (number >= 2).then_some(number)
}

/// Whether a file should be listed, accepted or not, among the photographs: by its extension, or
/// without one where its bytes are a picture's.
fn claims_to_be_a_photograph(entry: &Entry) -> bool {
    let path = Path::new(entry.name());
    named_like_a_photograph(path)
        || (path.extension().is_none() && crate::image::read_header(&entry.file).is_ok())
}

/// Removes folders that are around everything, such as the one that a zip of a folder has.
fn strip_wrappers(entries: &mut [Entry]) {
    loop {
        let tops: BTreeSet<Option<&str>> = entries
            .iter()
            .map(|e| e.path.split_once('/').map(|(top, _)| top))
            .collect();
        let wrapper = match tops.first() {
            Some(Some(top)) if tops.len() == 1 => *top,
            _ => return,
        };
        if KNOWN_FOLDERS
            .iter()
            .any(|known| known.eq_ignore_ascii_case(wrapper))
        {
            return;
        }
        let cut = wrapper.len() + 1;
        entries
            .iter_mut()
            .for_each(|entry| entry.path.drain(..cut).for_each(drop));
    }
}

/// Poses and their files. `sparse_gt/` is not looked at: poses are measured against it, it gives
/// none.
fn find_poses(entries: &[Entry]) -> (Option<GivenPosesFile>, Vec<Entry>) {
    let at = |path: &str| {
        entries
            .iter()
            .find(|e| e.path.eq_ignore_ascii_case(path))
            .cloned()
    };
    for folder in ["sparse/0", "sparse"] {
        for extension in ["bin", "txt"] {
            let parts = ["cameras", "images", "points3D"];
            let found: Vec<Entry> = parts
                .iter()
                .filter_map(|part| at(&format!("{folder}/{part}.{extension}")))
                .collect();
            // A model without points is one too: they can be triangulated.
            if found.len() >= 2 && found[1].stem().eq_ignore_ascii_case("images") {
                let model = found[0]
                    .file
                    .parent()
                    .map(ToOwned::to_owned)
                    .unwrap_or_default();
                return (Some(GivenPosesFile::ColmapModel(model)), found);
            }
        }
    }
    if let Some(entry) = at("transforms.json") {
        return (
            Some(GivenPosesFile::Transforms(entry.file.clone())),
            vec![entry],
        );
    }
    let bounds = at("poses_bounds.npy");
    (
        bounds
            .clone()
            .map(|entry| GivenPosesFile::PosesBounds(entry.file)),
        bounds.into_iter().collect(),
    )
}
