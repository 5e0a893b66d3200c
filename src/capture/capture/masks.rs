//! Finds the masks of a capture and assigns them to photographs.
//!
//! A mask has the name of its photograph and is in a folder `masks/` with another extension
//! (nerfstudio) or an additional one (COLMAP); or it is beside its photograph under a derived name;
//! or `mask_path` in a `transforms.json` names it.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use super::entries::{self, Entry};
use super::error::CaptureError;
use super::folders::{HOMES, MASKS, is_small_mask};
use super::photograph::CaptureWarning;
use crate::dataset::masks_of_transforms;
use crate::image::named_like_a_photograph;
use crate::mask::MaskPicture;
use crate::photo_path::{PhotoPath, find_each};

/// Prefix of a mask beside its photograph in instant-ngp, where non-black pixels are masked:
/// NVlabs/instant-ngp, issue 176, and `load_nerf` in its `nerf_loader.cu`.
const DYNAMIC: &str = "dynamic_mask_";

/// Suffix of a mask in Metashape and ODM, where black pixels are masked.
const END: &str = "_mask";

/// Masks, each with the name of its photograph relative to the capture.
#[derive(Debug, Default)]
pub(super) struct Found {
    all: Vec<Named>,
    /// Masks that poses name but that do not exist.
    missing: Vec<PhotoPath>,
}

#[derive(Clone, Debug)]
struct Named {
    photograph: PhotoPath,
    entry: Entry,
    white_hides: bool,
    by: By,
}

/// The evidence that assigns a mask to its photograph, strongest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum By {
    Poses,
    Name,
    Folder,
    SmallCopy,
}

/// Masks by photograph path.
#[derive(Debug, Default)]
pub(super) struct Masks(BTreeMap<PhotoPath, Vec<(Entry, MaskPicture)>>);

impl Masks {
    /// The masks of a photograph.
    pub(super) fn of(&self, photograph: &PhotoPath) -> Vec<(&Entry, &MaskPicture)> {
        let masks = self.0.get(photograph).into_iter().flatten();
        masks.map(|(entry, mask)| (entry, mask)).collect()
    }

    /// All masks.
    pub(super) fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.0.values().flatten().map(|(entry, _)| entry)
    }
}

/// The masks in a folder of photographs with these paths.
///
/// # Errors
/// [`CaptureError`] if the folder cannot be read.
pub fn masks_in(
    folder: &Path,
    photographs: &[PhotoPath],
) -> Result<BTreeMap<PhotoPath, Vec<MaskPicture>>, CaptureError> {
    let inside = |entry: Entry| Entry { path: entry.path.inside(MASKS[0]), ..entry };
    let mut pictures: Vec<Entry> = entries::of_folder(folder)?.into_iter().map(inside).collect();
    let photograph = |path: &PhotoPath| Entry::new(path.clone(), PathBuf::new());
    let photographs: Vec<Entry> = photographs.iter().map(photograph).collect();
    let masks = take(&mut pictures, &[]).of(&photographs, "", &mut Vec::new());
    let pictures = |all: Vec<(Entry, MaskPicture)>| all.into_iter().map(|(_, mask)| mask).collect();
    Ok(masks.0.into_iter().map(|(path, all)| (path, pictures(all))).collect())
}

/// Finds the masks and removes from `pictures` those in places where photographs may be.
pub(super) fn take(pictures: &mut Vec<Entry>, poses: &[&Entry]) -> Found {
    let mut found = Found::default();
    for file in poses.iter().filter(|e| e.path.name().to_ascii_lowercase().ends_with(".json")) {
        found.add_named_by_poses(file, pictures);
    }
    let paths: HashSet<String> =
        pictures.iter().map(|entry| entry.path.as_str().to_lowercase()).collect();
    let stems: HashSet<String> =
        pictures.iter().map(|entry| entry.path.stem().to_lowercase()).collect();
    for entry in &*pictures {
        let by_name = beside(entry, &paths, &stems);
        let by_folder = || in_folder(entry);
        found.all.extend(by_name.or_else(by_folder));
    }
    let is_taken = |entry: &Entry| {
        let masks = found.all.iter().filter(|named| named.by <= By::Name);
        masks.clone().any(|named| named.entry.file == entry.file)
    };
    pictures.retain(|entry| !is_taken(entry));
    found
}

impl Found {
    fn add_named_by_poses(&mut self, file: &Entry, pictures: &[Entry]) {
        // The poses report an unreadable file.
        let Ok(frames) = masks_of_transforms(&file.file) else {
            return;
        };
        let folder = file.path.folder();
        let by_path: BTreeMap<String, &Entry> =
            pictures.iter().map(|e| (e.path.as_str().to_lowercase(), e)).collect();
        for (photograph, mask) in frames {
            let path = mask.inside(folder);
            match by_path.get(&path.as_str().to_lowercase()) {
                Some(entry) => self.all.push(Named {
                    photograph: photograph.inside(folder),
                    entry: (*entry).clone(),
                    white_hides: false,
                    by: By::Poses,
                }),
                None => self.missing.push(path),
            }
        }
    }

    /// The masks of these photographs, which are in `folder`.
    pub(super) fn of(
        self,
        photographs: &[Entry],
        folder: &str,
        warnings: &mut Vec<CaptureWarning>,
    ) -> Masks {
        let keys: Vec<PhotoPath> =
            photographs.iter().map(|entry| key(&entry.path.inside(folder))).collect();
        let mut masks = Masks::default();
        let mut used: HashSet<&Path> = HashSet::new();
        for by in [By::Poses, By::Name, By::Folder, By::SmallCopy] {
            let these: Vec<&Named> = self.all.iter().filter(|named| named.by == by).collect();
            let names: Vec<PhotoPath> = these.iter().map(|named| key(&named.photograph)).collect();
            let found = find_each(&names, &keys).unwrap_or_else(|tie| {
                warnings.push(CaptureWarning::new("masks", format!("masks are not used: {tie}")));
                Vec::new()
            });
            for (entry, at) in photographs.iter().zip(found) {
                let Some(named) = at.map(|at| these[at]) else {
                    continue;
                };
                used.insert(&named.entry.file);
                let own = masks.0.entry(entry.path.clone()).or_default();
                let is_new = own.iter().all(|(other, _)| other.file != named.entry.file);
                if is_new && (by < By::SmallCopy || own.is_empty()) {
                    let white_hides = named.white_hides;
                    let picture = MaskPicture { file: named.entry.file.clone(), white_hides };
                    own.push((named.entry.clone(), picture));
                }
            }
        }
        let is_lost =
            |named: &&Named| named.by < By::SmallCopy && !used.contains(&*named.entry.file);
        let mut lost: Vec<&PhotoPath> =
            self.all.iter().filter(is_lost).map(|named| &named.entry.path).collect();
        lost.sort();
        lost.dedup();
        warn(warnings, "have no photograph of their name", &lost);
        warn(
            warnings,
            "are named by `mask_path` and are not there",
            &Vec::from_iter(&self.missing),
        );
        masks
    }
}

fn warn(warnings: &mut Vec<CaptureWarning>, what: &str, masks: &[&PhotoPath]) {
    if let Some(first) = masks.first() {
        let message = format!("{} masks {what}, the first is {first}", masks.len());
        warnings.push(CaptureWarning::new("masks", message));
    }
}

/// A mask beside its photograph.
fn beside(entry: &Entry, paths: &HashSet<String>, stems: &HashSet<String>) -> Option<Named> {
    let (folder, stem) = (entry.path.folder(), PhotoPath::new(entry.path.stem()));
    let named = |photograph: &str, white_hides| Named {
        photograph: PhotoPath::new(photograph).inside(folder),
        entry: entry.clone(),
        white_hides,
        by: By::Name,
    };
    let lower = stem.name().to_ascii_lowercase();
    if lower.starts_with(DYNAMIC) {
        return stem.name().get(DYNAMIC.len()..).map(|name| named(name, true));
    }
    let whole = |name: &str| PhotoPath::new(name).inside(folder).as_str().to_lowercase();
    let is_photograph = |name: &str| stems.contains(&whole(name)) || paths.contains(&whole(name));
    if lower.ends_with(END) {
        let name = stem.name().get(..stem.name().len() - END.len())?;
        return is_photograph(name).then(|| named(name, false));
    }
    // COLMAP's naming in a single folder.
    let is_double = named_like_a_photograph(Path::new(stem.name()));
    (is_double && paths.contains(&whole(stem.name()))).then(|| named(stem.name(), false))
}

/// A mask in a mask folder, which replaces the folder of the photographs in the path.
fn in_folder(entry: &Entry) -> Option<Named> {
    let by = match is_small_mask(entry) {
        true => By::SmallCopy,
        false if entry.path.lies_in(&MASKS) => By::Folder,
        false => return None,
    };
    let stem = PhotoPath::new(entry.path.stem());
    let is_double = named_like_a_photograph(Path::new(stem.name()));
    let is_ended = stem.as_str().to_ascii_lowercase().ends_with(END);
    let photograph = match stem.as_str() {
        _ if is_double => stem,
        stem if is_ended => PhotoPath::new(&stem[..stem.len() - END.len()]),
        _ => entry.path.clone(),
    };
    Some(Named { photograph, entry: entry.clone(), white_hides: false, by })
}

/// A path without the folders that distinguish photographs from their masks.
fn key(path: &PhotoPath) -> PhotoPath {
    let is_role = |part: &str| {
        let part = part.to_ascii_lowercase();
        let plain = part.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('_');
        HOMES.contains(&plain) || MASKS.contains(&plain)
    };
    let folders = path.folder().split('/').filter(|part| !is_role(part));
    let kept: Vec<&str> = folders.collect();
    PhotoPath::new(path.name()).inside(&kept.join("/"))
}

#[cfg(test)]
mod tests;
