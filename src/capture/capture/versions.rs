//! Two versions of one set of photographs side by side, such as before and after undistortion.

use std::collections::{BTreeMap, BTreeSet};

use super::entries::Entry;
use super::error::MIN_VIEWS;
use crate::dataset::GivenPoses;
use crate::image::read_header;
use crate::photo_path::PhotoPath;

/// Whether a path marks its pictures as undistorted.
pub(super) fn is_undistorted(path: &str) -> bool {
    let lower = path.to_lowercase();
    ["undist", "rectif"].iter().any(|part| lower.contains(part))
}

/// The folders that hold versions of one set: all contain the same names.
pub(super) fn of(pictures: &[&Entry]) -> BTreeSet<String> {
    let mut names: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    for entry in pictures {
        let name = PhotoPath::new(entry.path.name()).stem().to_lowercase();
        names.entry(entry.path.folder()).or_default().insert(name);
    }
    names.retain(|_, names| names.len() >= MIN_VIEWS);
    let least = names.values().map(BTreeSet::len).min().unwrap_or(0);
    let first = names.values().next().into_iter().flatten();
    let common = first.filter(|name| names.values().all(|names| names.contains(*name)));
    let are_versions = names.len() > 1 && 2 * common.count() >= least;
    names.into_keys().filter(|_| are_versions).map(ToOwned::to_owned).collect()
}

/// The version that the poses belong to.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Choice {
    /// Several: the folders are not versions.
    All,
    /// This one.
    One(String),
    /// Undetermined.
    Unknown,
}

/// Poses by photograph name, with the picture size of each lens, px.
struct Given {
    path: PhotoPath,
    views: Vec<(PhotoPath, Option<(usize, usize)>)>,
}

/// Chooses by the folders that the poses name, by picture size, and by folder and file names that
/// indicate undistortion, in this order.
pub(super) fn choose(folders: &BTreeSet<String>, pictures: &[&Entry], poses: &[&Entry]) -> Choice {
    let given: Vec<Given> = poses.iter().filter_map(|entry| Given::read(entry)).collect();
    let named: Vec<BTreeSet<&str>> = given.iter().map(|given| given.folders(folders)).collect();
    if named.iter().any(|named| named.len() > 1) {
        return Choice::All;
    }
    let all = || folders.iter().map(String::as_str);
    let is_named = |folder: &&str| named.iter().any(|named| named.contains(folder));
    let is_of_size = |folder: &&str| {
        let first = pictures.iter().find(|entry| entry.path.folder() == *folder);
        let header = first.and_then(|entry| read_header(&entry.file).ok());
        header
            .is_some_and(|header| given.iter().any(|given| given.has(header.width, header.height)))
    };
    // Prefer the originals if there are poses for them.
    let is_original = given.iter().any(|given| !is_undistorted(given.path.as_str()));
    let is_alike = |folder: &&str| is_undistorted(folder) != is_original;
    let only = |is: &dyn Fn(&&str) -> bool| {
        let mut found = all().filter(is);
        found.next().filter(|_| found.next().is_none())
    };
    let one = only(&is_named).or_else(|| only(&is_of_size)).or_else(|| only(&is_alike));
    one.map_or(Choice::Unknown, |folder| Choice::One(folder.to_owned()))
}

impl Given {
    fn read(entry: &Entry) -> Option<Self> {
        let name = entry.path.name().to_ascii_lowercase();
        let file = match &*name {
            "images.txt" | "images.bin" => entry.file.parent()?,
            _ if name.ends_with(".json") => &*entry.file,
            _ => return None,
        };
        let views = GivenPoses::open(file, &[]).and_then(|given| given.sizes()).ok()?;
        Some(Self { path: entry.path.clone(), views })
    }

    /// The folders that contain these names.
    fn folders<'a>(&self, folders: &'a BTreeSet<String>) -> BTreeSet<&'a str> {
        let last = |folder: &str| PhotoPath::new(folder).name().to_lowercase();
        // A name without a folder means the enclosing folder, if there is one.
        let is_around = |folder: &str| {
            folders
                .iter()
                .all(|other| PhotoPath::new(other).below(folder).is_some() || other == folder)
        };
        let lies_in = |name: &PhotoPath, folder: &str| {
            is_around(folder) && name.folder().is_empty() || name.lies_in(&[&last(folder)])
        };
        let is_named = |folder: &&str| self.views.iter().any(|(name, _)| lies_in(name, folder));
        folders.iter().map(String::as_str).filter(is_named).collect()
    }

    fn has(&self, width: usize, height: usize) -> bool {
        let sizes = [Some((width, height)), Some((height, width))];
        self.views.iter().any(|(_, size)| sizes.contains(size))
    }
}
