//! Two files of one exposure: phones and cameras write a JPEG beside a HEIC or a raw file. If both
//! were used, one could be trained on while the other is held out for measurement.

use std::collections::{HashMap, HashSet};

use super::entries::Entry;
use super::look::Seen;
use crate::photo_path::PhotoPath;

/// Minimum correlation of twins with the same name. They may be developed differently; different
/// subjects, or another viewpoint, are far below.
const ALIKE: f32 = 0.9;

/// Minimum correlation of twins with different names and the same brightness. Saving a picture in
/// another format preserves it.
const EQUAL: f32 = 0.9995;

/// Maximum relative difference in mean brightness of such twins.
const EQUAL_BRIGHTNESS: f32 = 0.02;

/// Extensions by how much of the exposure they preserve, most first; others are JPEG.
const KEEPING: [&[&str]; 4] =
    [&["tif", "tiff", "btf"], &["heic", "heif", "hif"], &["png"], &["webp"]];

/// In place of a position in [`KEEPING`], for raw files.
const RAW: usize = usize::MAX;

/// A photograph that may have twins.
struct One<'a> {
    entry: &'a Entry,
    seen: &'a Seen,
    /// Its path without the extension, in lower case.
    stem: String,
    /// Position of its format in [`KEEPING`], or [`RAW`].
    format: usize,
    extension: String,
}

/// The unused photographs by index, each with the index of the twin that is used. A photograph
/// named by the `named` poses is preferred, then a raw file, then the larger one, then the one
/// whose format preserves more.
pub(super) fn of(
    photographs: &[Entry],
    seen: &[Option<&Seen>],
    named: &[PhotoPath],
) -> HashMap<usize, usize> {
    let all = photographs.iter().zip(seen);
    let all: Vec<Option<One<'_>>> =
        all.map(|(entry, seen)| Some(One::new(entry, (*seen)?))).collect();
    let mut order: Vec<usize> = (0..all.len()).filter(|&at| all[at].is_some()).collect();
    let of = |at: usize| all[at].as_ref().expect("only those that are seen");
    let names: HashSet<&str> = named.iter().map(PhotoPath::name).collect();
    let rank = |one: &One<'_>| {
        let is_named = names.contains(one.entry.path.name());
        let pixels = one.seen.header.width * one.seen.header.height;
        let is_raw = one.seen.header.raw.is_some();
        (!is_named, !is_raw, usize::MAX - pixels, one.format)
    };
    order.sort_by_cached_key(|&at| rank(of(at)));
    let mut used: Vec<usize> = Vec::new();
    let mut twins = HashMap::new();
    for at in order {
        match used.iter().find(|&&other| of(other).is_twin_of(of(at))) {
            Some(&other) => drop(twins.insert(at, other)),
            None => used.push(at),
        }
    }
    twins
}

impl<'a> One<'a> {
    fn new(entry: &'a Entry, seen: &'a Seen) -> Self {
        let name = entry.path.name().to_lowercase();
        let extension = name.rsplit_once('.').map_or("", |(_, extension)| extension);
        let format = KEEPING.iter().position(|known| known.contains(&extension));
        let stem = entry.path.stem().to_lowercase();
        let format = match seen.header.raw {
            Some(_) => RAW,
            None => format.unwrap_or(KEEPING.len()),
        };
        let extension = extension.to_owned();
        Self { entry, seen, stem, format, extension }
    }

    fn is_twin_of(&self, other: &Self) -> bool {
        // A converter writes a DNG beside a camera's own raw file.
        let is_other_raw = self.format == RAW && self.extension != other.extension;
        if self.format == other.format && !is_other_raw {
            return false;
        }
        let [own, its] = [self, other].map(|one| &one.seen.header);
        let ratio = (own.width * its.height) as f64 / (own.height * its.width) as f64;
        if (ratio - 1.0).abs() > 0.01 {
            return false;
        }
        let [bright, dark] = [self.seen.mean_v, other.seen.mean_v];
        let is_equal = (bright - dark).abs() <= EQUAL_BRIGHTNESS * bright.max(dark);
        let least = match self.stem == other.stem {
            true => ALIKE,
            false if is_equal => EQUAL,
            false => return false,
        };
        self.seen.print.correlation(&other.seen.print) >= least
    }
}
