//! Folders whose names say what pictures they hold.

use super::entries::Entry;

/// Folders named after photographs: the first of these that exists contains them.
pub(super) const HOMES: [&str; 11] = [
    "images",
    "image",
    "rgb",
    "color",
    "colour",
    "input",
    "photos",
    "photographs",
    "photo",
    "frames",
    "dcim",
];

/// Mask folders.
pub(super) const MASKS: [&str; 2] = ["masks", "mask"];

/// The top-level names in a run's folder, without ground truth, which captures have, too.
const OF_A_RUN: [&str; 12] = [
    "scene.ply",
    "cameras.json",
    "metrics.json",
    "config.json",
    "poses.json",
    "poses.svg",
    "log.txt",
    "inputs",
    "restored",
    "rounds",
    "evaluation",
    "work",
];

/// Whether a run writes a file with this name, relative to its folder and with `/`.
pub fn is_of_a_run(name: &str) -> bool {
    name.split('/').next().is_some_and(|top| OF_A_RUN.contains(&top))
}

/// Whether a picture is in a folder like `masks_4/`, which has smaller masks.
pub(super) fn is_small_mask(entry: &Entry) -> bool {
    entry.path.folder().split('/').any(|part| {
        let part = part.to_ascii_lowercase();
        let number = { MASKS.iter() }.find_map(|f| part.strip_prefix(*f)?.strip_prefix('_'));
        number.is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
    })
}
