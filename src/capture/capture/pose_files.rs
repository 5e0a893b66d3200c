//! Finds the files of a capture that contain its poses.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::entries::Entry;
use super::error::MIN_VIEWS;
use super::photograph::CaptureWarning;
use super::versions::is_undistorted;
use crate::dataset::GivenPoses;
use crate::photo_path::PhotoPath;

/// Files with a meaning, other than photographs and `hold=N`.
pub(super) const POSE_FILES: [&str; 11] = [
    "cameras.txt",
    "images.txt",
    "points3d.txt",
    "cameras.bin",
    "images.bin",
    "points3d.bin",
    "transforms.json",
    "transforms_train.json",
    "transforms_val.json",
    "transforms_test.json",
    "poses_bounds.npy",
];

/// Poses included in the capture, by file format.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GivenPosesFile {
    /// The folder of a COLMAP model: `cameras`, `images` and `points3D`, as text or binary.
    ColmapModel(#[serde(with = "crate::path_serde")] PathBuf),
    /// NeRF's `transforms.json`.
    Transforms(#[serde(with = "crate::path_serde")] PathBuf),
    /// LLFF's `poses_bounds.npy`.
    PosesBounds(#[serde(with = "crate::path_serde")] PathBuf),
}

impl GivenPosesFile {
    /// The folder or file.
    pub fn path(&self) -> &Path {
        match self {
            Self::ColmapModel(path) | Self::Transforms(path) | Self::PosesBounds(path) => path,
        }
    }
}

/// Folders in which COLMAP models are looked for, either the model itself or one folder per model;
/// "" is the capture's root, which may only be a model itself. `sparse_gt/` is excluded: it is the
/// reference for measuring poses, not a source of poses.
const MODELS: [&str; 4] = ["sparse", "colmap/sparse", "dense/sparse", ""];

/// Folders whose models are not poses of the capture.
const NO_POSES: [&str; 1] = ["sparse_gt"];

/// One warning for each program whose pose format is unsupported.
pub(super) fn foreign(files: &[(Entry, &'static str)]) -> Vec<CaptureWarning> {
    let mut programs: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (entry, program) in files.iter().filter(|(entry, _)| !entry.path.lies_in(&NO_POSES)) {
        programs.entry(program).or_default().push(entry.path.as_str());
    }
    let warning = |(program, files): (&str, Vec<&str>)| {
        let holds = match files.len() {
            1 => format!("{} holds", files[0]),
            count => format!("{} and {} more files hold", files[0], count - 1),
        };
        let message = format!(
            "{holds} poses that are not read, and poses are found anew: to use them, make a COLMAP \
             model or a transforms.json of them with {program} or a converter"
        );
        CaptureWarning::new("poses_unused", message)
    };
    programs.into_iter().map(warning).collect()
}

/// One set of poses of the capture.
struct Set {
    /// The path inside the capture, for messages.
    name: String,
    given: GivenPosesFile,
    files: Vec<Entry>,
}

/// The names of photographs in NeRF pose files, relative to the capture, with folders. Files
/// renamed by the user count only if there are no others.
pub(super) fn names(entries: &[&Entry]) -> Vec<PhotoPath> {
    let json = { entries.iter() }.filter(|e| e.path.name().to_ascii_lowercase().ends_with(".json"));
    let (known, others): (Vec<&Entry>, Vec<&Entry>) =
        json.copied().partition(|e| has_known_name(e));
    let json = if known.is_empty() { others } else { known };
    let names = json.into_iter().filter_map(|entry| {
        let names = GivenPoses::open(&entry.file, &[]).ok()?.names().ok()?;
        let folder = entry.path.folder().to_owned();
        Some(names.into_iter().map(move |name| name.inside(&folder)))
    });
    names.flatten().collect()
}

/// The poses of photographs in `folder`, and their files. Poses in known places come first, beside
/// that folder before the capture's root; otherwise the ones anywhere that cover most photographs,
/// in order of preference. Some may belong to pictures `elsewhere`, which are not read.
pub(super) fn find(
    entries: &[Entry],
    folder: &str,
    photographs: &[Entry],
    elsewhere: &[Entry],
    warnings: &mut Vec<CaptureWarning>,
) -> Option<(GivenPosesFile, Vec<Entry>)> {
    let own: Vec<PhotoPath> = photographs.iter().map(|e| e.path.inside(folder)).collect();
    let of_these = |mut sets: Vec<Set>| {
        sets.retain(|set| !set.is_beside(elsewhere, &own));
        sets
    };
    let near = PhotoPath::new(folder);
    let known = [near.folder(), ""].map(|base| of_these(in_known_places(entries, base)));
    let known = known.into_iter().find(|sets| !sets.is_empty());
    let is_known = known.is_some();
    let mut sets = known.unwrap_or_else(|| of_these(anywhere(entries)));
    if !(is_known && sets.len() == 1) {
        let counts: Vec<Option<usize>> = sets.iter().map(|set| posed(set, photographs)).collect();
        let most = counts.iter().max().copied().flatten();
        if !is_known && most.is_none_or(|most| most < MIN_VIEWS) {
            warnings.extend(unused(entries, &sets, &counts));
            return None;
        }
        // Of poses before and after undistortion, prefer those of these photographs.
        let is_alike = |at: &usize| is_undistorted(&sets[*at].name) == is_undistorted(folder);
        let firsts = || (0..sets.len()).filter(|at| counts[*at] == most);
        let first = firsts().find(is_alike).or_else(|| firsts().next()).unwrap_or(0);
        let which = match sets.len() {
            1 => String::new(),
            count => format!(", one of {count} sets"),
        };
        let message = format!(
            "the poses of {} are taken{which}; photographs with a pose: {}",
            sets[first].name,
            in_words(&sets, &counts)
        );
        warnings.push(CaptureWarning::new("models", message));
        sets.swap(0, first);
    }
    let Set { given, files, .. } = sets.into_iter().next()?;
    Some((given, files))
}

impl Set {
    /// Whether a folder around them has several of these pictures and no photographs.
    fn is_beside(&self, pictures: &[Entry], photographs: &[PhotoPath]) -> bool {
        let own = self.files[0].path.folder();
        let ends = own.match_indices('/').map(|(at, _)| at);
        let mut around = ends.chain([own.len()]).map(|end| &own[..end]).filter(|f| !f.is_empty());
        around.any(|folder| {
            let inside = pictures.iter().filter(|e| e.path.below(folder).is_some());
            inside.count() >= MIN_VIEWS && photographs.iter().all(|p| p.below(folder).is_none())
        })
    }
}

/// The names of photographs in the poses that are used; empty if the poses are unreadable.
pub(super) fn names_in(given: Option<&GivenPosesFile>) -> Vec<PhotoPath> {
    let names = given.map(|given| GivenPoses::open(given.path(), &[]).and_then(|it| it.names()));
    names.and_then(Result::ok).unwrap_or_default()
}

/// Whether a pose file has a name that programs use.
fn has_known_name(entry: &Entry) -> bool {
    POSE_FILES.contains(&&*entry.path.name().to_ascii_lowercase())
}

/// Number of photographs with one of these poses; `None` if the poses are unreadable.
fn posed(set: &Set, photographs: &[Entry]) -> Option<usize> {
    let photographs: Vec<PhotoPath> = photographs.iter().map(|e| e.path.clone()).collect();
    let given = GivenPoses::open(set.given.path(), &photographs);
    given.and_then(|given| given.count()).ok()
}

fn in_words(sets: &[Set], counts: &[Option<usize>]) -> String {
    let one = |(set, count): (&Set, &Option<usize>)| match count {
        Some(count) => format!("{} {count}", set.name),
        None => format!("{} cannot be read", set.name),
    };
    let all: Vec<String> = sets.iter().zip(counts).map(one).collect();
    all.join(", ")
}

/// A warning about unused pose files.
fn unused(entries: &[Entry], sets: &[Set], counts: &[Option<usize>]) -> Option<CaptureWarning> {
    if !sets.is_empty() {
        let message = format!(
            "poses are not used, as too few photographs have the names in them: {}",
            in_words(sets, counts)
        );
        return Some(CaptureWarning::new("poses_unused", message));
    }
    let is_part = |e: &&Entry| has_known_name(e) && !e.path.lies_in(&NO_POSES);
    let lone: Vec<&str> = { entries.iter() }.filter(is_part).map(|e| e.path.as_str()).collect();
    let message = format!(
        "no poses are read from {}: a COLMAP model is `cameras` and `images` in one folder, both \
         .bin or both .txt, and poses beside other pictures are those of them",
        lone.join(", ")
    );
    (!lone.is_empty()).then(|| CaptureWarning::new("poses_unused", message))
}

/// The poses in the places where programs write them, relative to the folder `base`.
fn in_known_places(entries: &[Entry], base: &str) -> Vec<Set> {
    let models = { MODELS.iter() }.flat_map(|folder| models_in(entries, base, folder));
    models.chain(files_in(entries, base)).collect()
}

/// The poses in any folder.
fn anywhere(entries: &[Entry]) -> Vec<Set> {
    let sets = { entries.iter() }.filter(|e| !e.path.lies_in(&NO_POSES));
    let folders: BTreeSet<&str> = sets.map(|entry| entry.path.folder()).collect();
    let sets = folders.iter().flat_map(|folder| {
        let models = models_in(entries, folder, "");
        let files = models.into_iter().chain(files_in(entries, folder));
        files.chain(renamed_in(entries, folder))
    });
    sets.collect()
}

/// NeRF pose files renamed by the user in a folder.
fn renamed_in(entries: &[Entry], folder: &str) -> Vec<Set> {
    let is_json = |e: &Entry| e.path.name().to_ascii_lowercase().ends_with(".json");
    let renamed = { entries.iter() }
        .filter(|e| e.path.folder() == folder && is_json(e) && !has_known_name(e));
    let set = |entry: &Entry| Set {
        name: entry.path.to_string(),
        given: GivenPosesFile::Transforms(entry.file.clone()),
        files: vec![entry.clone()],
    };
    renamed.map(set).collect()
}

/// The NeRF and LLFF pose files in a folder.
fn files_in(entries: &[Entry], folder: &str) -> Vec<Set> {
    let at = |name: &str| {
        let path = PhotoPath::new(name).inside(folder);
        let mut all = entries.iter();
        all.find(|e| e.path.as_str().eq_ignore_ascii_case(path.as_str())).cloned()
    };
    let splits = ["transforms_train.json", "transforms_val.json", "transforms_test.json"];
    let files = [&["transforms.json"][..], &splits, &["poses_bounds.npy"]];
    let sets = files.iter().filter_map(|names| {
        let files: Vec<Entry> = names.iter().filter_map(|name| at(name)).collect();
        let first = files.first()?;
        let file = first.file.clone();
        let given = match names[0] {
            "poses_bounds.npy" => GivenPosesFile::PosesBounds(file),
            _ => GivenPosesFile::Transforms(file),
        };
        let name = first.path.to_string();
        Some(Set { name, given, files })
    });
    sets.collect()
}

/// The models in a folder, binary before text. A model without points also counts: its points can
/// be triangulated.
fn models_in(entries: &[Entry], base: &str, folder: &str) -> Vec<Set> {
    let mut paths: Vec<&str> = Vec::new();
    let mut models = Vec::new();
    for extension in ["bin", "txt"] {
        let is_part = |e: &Entry, part: &str| {
            e.path.name().eq_ignore_ascii_case(&format!("{part}.{extension}"))
        };
        for cameras in entries.iter().filter(|e| is_part(e, "cameras")) {
            let own = cameras.path.folder();
            let Some(path) = cameras.path.below(base) else {
                continue;
            };
            let (parent, _) = path.folder().rsplit_once('/').unwrap_or_default();
            let is_inside = !folder.is_empty() && parent.eq_ignore_ascii_case(folder);
            if !(is_inside || path.folder().eq_ignore_ascii_case(folder)) || paths.contains(&own) {
                continue;
            }
            let part = |name: &str| {
                let mut all = entries.iter();
                all.find(|e| e.path.folder() == own && is_part(e, name))
            };
            let Some(images) = part("images") else {
                continue;
            };
            let files = [Some(cameras), Some(images), part("points3d")];
            let lies_in = cameras.file.parent();
            let lies_in = lies_in.map(ToOwned::to_owned).unwrap_or_default();
            paths.push(own);
            models.push(Set {
                name: match own {
                    "" => "the capture's own folder".to_owned(),
                    own => own.to_owned(),
                },
                given: GivenPosesFile::ColmapModel(lies_in),
                files: files.into_iter().flatten().cloned().collect(),
            });
        }
    }
    models
}
