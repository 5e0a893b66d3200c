//! Finds the folders that contain the photographs of a capture.

use std::collections::{BTreeMap, BTreeSet};

use super::entries::Entry;
use super::error::{CaptureError, MIN_VIEWS, in_words};
use super::folders::{HOMES, is_small_mask};
use super::photograph::CaptureWarning;
use super::versions::{self, Choice};
use crate::photo_path::PhotoPath;

/// Ground truth folders.
pub(super) const TRUTH: [&str; 2] = ["gt", "hl"];

/// Folders of pictures derived from the photographs, as scanners and trainers write them.
pub(super) const MADE: [&str; 22] = [
    "depth",
    "depths",
    "depth_maps",
    "depthmaps",
    "depth_map",
    "mask",
    "masks",
    "normal",
    "normals",
    "confidence",
    "conf",
    "semantic",
    "semantics",
    "segmentation",
    "corrected_images",
    "thumb",
    "thumbs",
    "thumbnail",
    "thumbnails",
    "preview",
    "previews",
    "sparse_gt",
];

/// Suffixes of other such folders.
const MADE_ENDS: [&str; 4] = ["_mask", "_masks", "_depth", "_depths"];

/// Folders that divide the photographs of one scene.
const PARTS: [&[&str]; 2] = [
    &["train", "test", "val", "valid", "validation", "eval"],
    &[
        "left", "right", "front", "back", "rear", "top", "bottom", "up", "down", "middle",
        "center", "centre",
    ],
];

/// Whether a picture is in a folder of derived pictures, or in one like `sam_masks/`.
fn is_made(entry: &Entry) -> bool {
    let ends_so = |part: &str| {
        let part = part.to_ascii_lowercase();
        MADE_ENDS.iter().any(|end| part.ends_with(end))
    };
    entry.path.lies_in(&MADE) || is_small_mask(entry) || entry.path.folder().split('/').any(ends_so)
}

/// Whether the pictures are a low-light set: photographs in `low/` and, for some of them, bright
/// ones with the same names in `high/`. Removes `low/` from the paths, as the photographs are
/// there.
pub(super) fn part_low_light(pictures: &mut [Entry]) -> bool {
    let is_low = |entry: &Entry| top(entry).is_some_and(|top| top.eq_ignore_ascii_case("low"));
    let below = |entry: &Entry| entry.path.below(top(entry)?);
    let stem = |entry: &Entry| below(entry).map(|path| path.stem().to_lowercase());
    let low: BTreeSet<_> = { pictures.iter() }.filter(|e| is_low(e)).filter_map(stem).collect();
    let mut high = { pictures.iter() }.filter(|e| is_high(e)).filter_map(stem).peekable();
    if high.peek().is_none() || !high.all(|stem| low.contains(&stem)) {
        return false;
    }
    for entry in pictures.iter_mut().filter(|entry| is_low(entry)) {
        entry.path = below(entry).expect("it lies in `low/`");
    }
    true
}

/// Whether a picture is in `high/`, which some sets call `normal/`.
pub(super) fn is_high(entry: &Entry) -> bool {
    let is_called = |top: &str| ["high", "normal"].iter().any(|n| top.eq_ignore_ascii_case(n));
    top(entry).is_some_and(is_called)
}

/// Where the photographs are.
#[derive(Debug)]
pub(super) struct Place {
    /// Their common folder.
    pub(super) folder: String,
    /// The photographs, with paths relative to it.
    pub(super) photographs: Vec<Entry>,
    /// Pictures elsewhere, which are not read.
    pub(super) others: Vec<Entry>,
    /// A warning about those pictures.
    pub(super) warning: Option<CaptureWarning>,
}

impl Place {
    /// Uses the pictures that the poses name instead of others with the same names.
    pub(super) fn named_by(self, names: &[PhotoPath]) -> Self {
        let folders: BTreeSet<&str> = names.iter().map(PhotoPath::folder).collect();
        let is_named = |entry: &Entry| {
            let folder = entry.path.folder();
            !folder.is_empty() && folders.contains(folder) && !is_copy(entry)
        };
        let own = { self.photographs.iter() }
            .map(|entry| Entry { path: entry.path.inside(&self.folder), ..entry.clone() });
        let own: Vec<Entry> = own.collect();
        let named: Vec<&Entry> = self.others.iter().filter(|e| is_named(e)).collect();
        if own.iter().any(is_named) || named.len() < MIN_VIEWS {
            return self;
        }
        let of_named: BTreeSet<&str> = named.iter().map(|entry| entry.path.folder()).collect();
        let folder = match of_named.first() {
            Some(folder) if of_named.len() == 1 => (*folder).to_owned(),
            _ => String::new(),
        };
        chosen(&folder, own.into_iter().chain(self.others).collect(), is_named)
    }
}

/// Whether a picture is a small copy of a photograph, as in LLFF sets.
fn is_copy(entry: &Entry) -> bool {
    top(entry).is_some_and(|top| top.to_ascii_lowercase().starts_with("images_"))
}

/// The photographs among all pictures except ground truth. Poses in the capture identify them, so
/// folders of any name may divide them, unless each folder has its own `poses`. If there are no
/// photographs, the error may mention a video.
///
/// # Errors
/// [`CaptureError::NoPhotographs`], [`CaptureError::Scattered`].
pub(super) fn find(
    pictures: Vec<Entry>,
    poses: &[&Entry],
    video: Option<&Entry>,
) -> Result<Place, CaptureError> {
    let (made, candidates): (Vec<_>, Vec<_>) = { pictures.into_iter() }.partition(is_made);
    if candidates.is_empty() {
        return Err(CaptureError::NoPhotographs {
            seen: places(&made),
            video: video.map(|entry| entry.path.to_string()),
            result: None,
        });
    }
    let in_root = { candidates.iter() }.filter(|entry| entry.path.folder().is_empty()).count();
    let tops: BTreeSet<&str> = candidates.iter().filter_map(top).collect();
    let in_images = { candidates.iter() }.filter(|entry| top(entry).is_some_and(is_images));
    let has_images = in_images.count() >= MIN_VIEWS;
    if !has_images && in_root >= MIN_VIEWS && !are_spanned(&tops, poses) {
        return Ok(chosen("", candidates, |entry| entry.path.folder().is_empty()));
    }
    for home in HOMES {
        if let Some(homes) = called(home, &candidates) {
            let is_inside = |entry: &Entry| homes.iter().any(|h| entry.path.below(h).is_some());
            // Too few beside others are a logo or a cover.
            let inside = candidates.iter().filter(|entry| is_inside(entry)).count();
            if inside < MIN_VIEWS.min(candidates.len()) {
                continue;
            }
            let parents: BTreeSet<&str> =
                { homes.iter() }.map(|home| home.rsplit_once('/').map_or("", |(p, _)| p)).collect();
            if homes.len() > 1 && !are_spanned(&parents, poses) && !are_parts(&parents) {
                return Err(scattered(&candidates));
            }
            let folder = if homes.len() == 1 { homes[0].clone() } else { String::new() };
            return Ok(chosen(&folder, candidates, is_inside));
        }
    }
    if let Some(folder) = version(&candidates, poses)? {
        return Ok(chosen(&folder, candidates, |entry| entry.path.folder() == folder));
    }
    let are_copies = candidates.iter().any(is_copy);
    let are_spanned = are_spanned(&tops, poses);
    let is_one = tops.len() < 2 || !are_copies && (are_spanned || are_parts(&tops));
    if !is_one {
        return Err(scattered(&candidates));
    }
    // Too few beside a folder are its cover.
    let all = are_spanned || tops.is_empty() || in_root >= MIN_VIEWS;
    let only = tops.first().filter(|_| tops.len() == 1 && in_root == 0);
    let folder = only.map_or_else(String::new, |top| (*top).to_owned());
    Ok(chosen(&folder, candidates, |entry| all || top(entry).is_some()))
}

/// The folder whose pictures match the poses, if other folders have versions of them.
///
/// # Errors
/// [`CaptureError::Scattered`] if it cannot be determined.
fn version(candidates: &[Entry], poses: &[&Entry]) -> Result<Option<String>, CaptureError> {
    let pictures: Vec<&Entry> = candidates.iter().filter(|entry| !is_copy(entry)).collect();
    let folders = versions::of(&pictures);
    let names = folders.iter().map(|folder| folder.rsplit('/').next().unwrap_or_default());
    if folders.is_empty() || poses.is_empty() || are_parts(&names.collect()) {
        return Ok(None);
    }
    match versions::choose(&folders, &pictures, poses) {
        Choice::All => Ok(None),
        Choice::One(folder) => Ok(Some(folder)),
        Choice::Unknown => Err(scattered(candidates)),
    }
}

fn is_images(folder: &str) -> bool {
    folder.eq_ignore_ascii_case(HOMES[0])
}

/// The first folder.
fn top(entry: &Entry) -> Option<&str> {
    entry.path.as_str().split_once('/').map(|(top, _)| top)
}

/// The folders with this name at the lowest depth.
fn called(name: &str, entries: &[Entry]) -> Option<Vec<String>> {
    let mut by_depth: BTreeMap<usize, BTreeSet<String>> = BTreeMap::new();
    for entry in entries {
        let parts: Vec<&str> = entry.path.folder().split('/').collect();
        if let Some(at) = parts.iter().position(|part| part.eq_ignore_ascii_case(name)) {
            by_depth.entry(at).or_default().insert(parts[..=at].join("/"));
        }
    }
    let least = by_depth.into_values().next()?;
    Some(least.into_iter().collect())
}

/// Whether there are poses outside these folders, which can cover all of them.
fn are_spanned(folders: &BTreeSet<&str>, poses: &[&Entry]) -> bool {
    let is_outside = |folder: &&str, e: &Entry| folder.is_empty() || e.path.below(folder).is_none();
    poses.iter().any(|e| folders.iter().all(|folder| is_outside(folder, e)))
}

/// Whether folders divide one scene: by known words, or numbered like `cam0` and `cam1`, or
/// `100CANON` and `101CANON`.
fn are_parts(folders: &BTreeSet<&str>) -> bool {
    let all = |is: &dyn Fn(&str) -> bool| { folders.iter() }.all(|f| is(&f.to_ascii_lowercase()));
    // Cameras name the folders of a card like this.
    let is_numbered = |f: &str| f.len() == 8 && f.bytes().take(3).all(|b| b.is_ascii_digit());
    let is_camera = |f: &str| {
        let word = f.trim_matches(|c: char| c.is_ascii_digit() || "_- ".contains(c));
        ["cam", "camera", "view", "sensor", "lens"].contains(&word)
    };
    all(&is_numbered)
        || all(&is_camera)
        || PARTS.iter().any(|words| all(&|folder| words.contains(&folder)))
}

/// The matching candidates, with paths relative to `folder`.
fn chosen(folder: &str, candidates: Vec<Entry>, is_meant: impl Fn(&Entry) -> bool) -> Place {
    let (meant, others): (Vec<_>, Vec<_>) = candidates.into_iter().partition(is_meant);
    let listed: Vec<Entry> = { others.iter() }.filter(|e| !is_copy(e)).cloned().collect();
    let warning = (!listed.is_empty()).then(|| {
        let message = format!(
            "photographs are read from {}; not from {}: move them there if they belong to it",
            in_words(&places(&meant)),
            in_words(&places(&listed))
        );
        CaptureWarning::new("elsewhere", message)
    });
    let photographs = { meant.into_iter() }
        .map(|entry| Entry { path: entry.path.below(folder).unwrap_or(entry.path), ..entry });
    Place { folder: folder.to_owned(), photographs: photographs.collect(), others, warning }
}

fn scattered(candidates: &[Entry]) -> CaptureError {
    CaptureError::Scattered { seen: places(candidates) }
}

/// Folders with the number of pictures in each.
fn places(entries: &[Entry]) -> Vec<(String, usize)> {
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    for entry in entries {
        *places.entry(entry.path.folder().to_owned()).or_default() += 1;
    }
    places.into_iter().collect()
}
