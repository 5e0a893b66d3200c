//! Assesses which photographs can be used and what to warn the user about.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::io;
use std::path::Path;

use crate::image::{Header, ImageError, Unread};
use crate::photo_path::PhotoPath;

use super::entries::Entry;
use super::layout::Layout;
use super::look::{Assessor, Fault, Seen};
use super::masked;
use super::photograph::{Assessment, CaptureView, CaptureWarning};
use super::pose_files;
use super::preparation::{Kind, Preparation};
use super::twins;
use super::watch::Watch;

/// A capture with fewer photographs is accepted with a warning.
pub const FEW_VIEWS: usize = 12;

/// Why a video beside photographs is not used.
const UNUSED_VIDEO: &str = "a video; one that is given by itself is taken apart into photographs";

/// Maximum length of our own names.
const LONGEST_NAME: usize = 40;

/// The outcome for the whole capture.
pub(super) struct Assessed {
    pub(super) views: Vec<CaptureView>,
    /// All paths except second files of one exposure, which share the poses of the first.
    pub(super) photographs: Vec<PhotoPath>,
    pub(super) assessments: Vec<Assessment>,
    pub(super) warnings: Vec<CaptureWarning>,
}

/// Assesses every photograph, then the capture, and prepares the images.
///
/// # Errors
/// A failure to write a prepared image.
pub(super) fn assess(
    layout: &Layout,
    watch: &Watch<'_>,
    preparation: &Preparation,
) -> io::Result<Assessed> {
    let truths = layout.ground_truth.values();
    let others = truths.chain(layout.masks.entries());
    let assessor = Assessor::open(watch, preparation, layout.photographs.iter().chain(others));
    let seen = assessor.look_at_all(&layout.photographs);
    let masked = masked::look_at_masks(&layout.photographs, &seen, &layout.masks, &assessor);
    let typical = median(seen.iter().flatten().map(|seen| seen.sharpness).collect());
    let mut assessed = Assessed {
        views: Vec::new(),
        photographs: Vec::new(),
        assessments: Vec::new(),
        warnings: layout.warnings.clone(),
    };
    let copies = copies(layout, &seen);
    let twins = twins(layout, &seen, &copies);
    let mut names = Names::default();
    for (at, (entry, seen)) in layout.photographs.iter().zip(seen).enumerate() {
        let masked = &masked[at];
        let called = |at: &usize| layout.photographs[*at].name();
        let twin = twins.get(&at).map(called);
        if twin.is_none() {
            assessed.photographs.push(entry.path.clone());
        }
        let seen = seen.and_then(|seen| {
            let fault = match (copies.get(&at).map(called), twin) {
                (Some(original), _) => Some(Fault::of(format!("the same picture as {original}"))),
                (None, Some(twin)) => Some(Fault::of(format!("the same exposure as {twin}"))),
                (None, None) => masked.fault(),
            };
            seen.unless(fault)
        });
        match seen {
            Ok(seen) => {
                let name = names.own(entry.name().stem());
                let named = |image: &Option<_>, kind| assessor.named(image.clone(), kind, &name);
                let prepared = named(&seen.prepared, Kind::View).unwrap_or_default();
                let mask = named(&masked.mask, Kind::Mask);
                assessed.accept(
                    entry,
                    &seen,
                    typical,
                    CaptureView {
                        mask,
                        ..CaptureView::upright(name, entry.path.clone(), prepared)
                    },
                );
            }
            Err(fault) => {
                masked.discard();
                assessed.assessments.push(fault.assessment(entry));
            }
        }
    }
    assessed.assessments.extend(layout.unused.iter().map(unused));
    let of_masks = masked::warnings(&assessed.views, &masked);
    assessed.warnings.extend(of_masks);
    assessed.attach_ground_truth(&layout.ground_truth, &assessor);
    assessed.warn_of_the_whole();
    assessor.into_failure().map_or(Ok(assessed), Err)
}

/// The assessment of a file that is listed only.
fn unused(entry: &Entry) -> Assessment {
    let fault = match Unread::named(Path::new(entry.path.name())) {
        Some(format) => Fault::from(ImageError::Unread(format)),
        None => Fault::of(UNUSED_VIDEO.to_owned()),
    };
    fault.assessment(entry)
}

/// The photographs whose picture another one also has, each with that one. Of equal pictures the
/// one with the shortest path is kept, as copies are called `a (1)` and `a copy`.
fn copies(layout: &Layout, seen: &[Result<Seen, Fault>]) -> HashMap<usize, usize> {
    let length = |at: usize| layout.photographs[at].name().as_str().len();
    let mut originals: HashMap<[u8; 32], usize> = HashMap::new();
    let pictures = seen.iter().enumerate();
    let pictures = pictures.filter_map(|(at, seen)| Some((at, seen.as_ref().ok()?.picture)));
    for (at, picture) in pictures.clone() {
        let original = originals.entry(picture).or_insert(at);
        if length(at) < length(*original) {
            *original = at;
        }
    }
    let copies = pictures.map(|(at, picture)| (at, originals[&picture]));
    copies.filter(|(at, original)| at != original).collect()
}

/// The second files of exposures, each with the file that is used.
fn twins(
    layout: &Layout,
    seen: &[Result<Seen, Fault>],
    copies: &HashMap<usize, usize>,
) -> HashMap<usize, usize> {
    let seen = seen.iter().enumerate();
    let seen = seen.map(|(at, seen)| seen.as_ref().ok().filter(|_| !copies.contains_key(&at)));
    let named = pose_files::names_in(layout.poses.as_ref());
    twins::of(&layout.photographs, &seen.collect::<Vec<_>>(), &named)
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

impl Assessed {
    fn accept(&mut self, entry: &Entry, seen: &Seen, typical_sharpness: f32, view: CaptureView) {
        let Header { width, height, orientation, focal_px, shot, .. } = seen.header;
        self.assessments.push(Assessment {
            name: entry.name().to_string(),
            view: Some(view.name.clone()),
            accepted: true,
            reason: None,
            unsupported_format: false,
            width,
            height,
            focal_px,
            colours: seen.header.colours(),
            brightness: Some(seen.mean_v),
            sharpness: Some(seen.sharpness / typical_sharpness.max(1e-12)),
            warnings: seen.warnings(typical_sharpness),
        });
        self.views.push(CaptureView {
            file: entry.file.clone(),
            width,
            height,
            focal_px,
            orientation: orientation.to_exif(),
            shot,
            ..view
        });
    }

    /// Attaches ground truth to each view whose shape it has.
    fn attach_ground_truth(
        &mut self,
        ground_truth: &HashMap<PhotoPath, Entry>,
        assessor: &Assessor<'_>,
    ) {
        if ground_truth.is_empty() {
            return;
        }
        let find = |view: &CaptureView| ground_truth.get(&view.path);
        let found = assessor.truths(&self.views, find);
        let (mut missing, mut unusable) = (Vec::new(), Vec::new());
        for (view, found) in self.views.iter_mut().zip(found) {
            match found {
                Some(Some(truth)) => view.gt = Some(truth),
                Some(None) => unusable.push(view.path.as_str()),
                None => missing.push(view.path.as_str()),
            }
        }
        let mut warn = |code: &str, what: &str, names: &[&str]| {
            if let Some(first) = names.first() {
                let message = format!("{} photographs {what}, the first is {first}", names.len());
                self.warnings.push(CaptureWarning::new(code, message));
            }
        };
        warn("gt_missing", "have no ground truth", &missing);
        warn("gt_size", "have ground truth that cannot be read or has another shape", &unusable);
    }

    fn warn_of_the_whole(&mut self) {
        let count = self.views.len();
        if count < FEW_VIEWS {
            self.warnings.push(CaptureWarning::new(
                "few",
                format!(
                    "{count} photographs are few: 20 to 60 give a much better scene, and below \
                     {FEW_VIEWS} none is held out for the measurements unless `held_out` asks \
                     for it"
                ),
            ));
        }
        let mut sizes: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        self.views
            .iter()
            .for_each(|view| *sizes.entry((view.width, view.height)).or_default() += 1);
        if let (Some((size, most)), true) =
            (sizes.iter().max_by_key(|entry| entry.1), sizes.len() > 1)
        {
            let message = format!(
                "{} of {count} photographs are not of {} x {} px as the others",
                count - most,
                size.0,
                size.1
            );
            self.warnings.push(CaptureWarning::new("mixed_sizes", message));
        }
    }
}

/// Our own names for the accepted photographs with these names, in the order of their assessments.
pub fn view_names<'a>(accepted: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut names = Names::default();
    accepted.map(|name| names.own(PhotoPath::new(name).stem())).collect()
}

/// The names assigned so far, in lower case.
#[derive(Default)]
struct Names {
    taken: HashSet<String>,
    /// The last number appended to each name. It only grows, so thousands of equal names cost no
    /// more than different ones.
    numbers: HashMap<String, u32>,
}

impl Names {
    /// Our own name for a view: the path with all characters except letters, digits, `-` and `_`
    /// replaced, never empty, never starting like an option, unique even ignoring case.
    fn own(&mut self, stem: &str) -> String {
        let safe = |c: char| {
            if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') { c } else { '_' }
        };
        let mut base: String = stem.chars().take(LONGEST_NAME).map(safe).collect();
        if !base.starts_with(|c: char| c.is_ascii_alphanumeric()) {
            base.insert(0, 'v');
            base.truncate(LONGEST_NAME);
        }
        if self.taken.insert(base.to_ascii_lowercase()) {
            return base;
        }
        let number = self.numbers.entry(base.to_ascii_lowercase()).or_insert(1);
        loop {
            *number += 1;
            let suffix = format!("_{number}");
            let kept = base.len().min(LONGEST_NAME - suffix.len());
            let name = format!("{}{suffix}", &base[..kept]);
            if self.taken.insert(name.to_ascii_lowercase()) {
                return name;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_stay_recognisable_and_become_unique() {
        let mut names = Names::default();
        let mut name = |stem: &str| names.own(stem);
        assert_eq!(name("100_7100"), "100_7100");
        assert_eq!(name("Küche 1"), "K_che_1");
        assert_eq!(name("-rf"), "v-rf");
        assert_eq!(name("a"), "a");
        assert_eq!(name("A"), "A_2");
        assert_eq!(name(""), "v");
        assert_eq!(name("📷"), "v_");
    }

    proptest! {
        #[test]
        fn any_names_become_safe_and_distinct(stems in prop::collection::vec(".{0,60}", 1..20)) {
            let mut names = Names::default();
            for stem in &stems {
                let name = names.own(stem);
                prop_assert!((1..=LONGEST_NAME).contains(&name.len()));
                prop_assert!(name.starts_with(|c: char| c.is_ascii_alphanumeric()));
                let safe = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
                prop_assert!(name.chars().all(safe));
            }
            prop_assert_eq!(names.taken.len(), stems.len());
        }
    }
}
