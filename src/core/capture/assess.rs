//! What can be used, and what the user should know about it.

use std::collections::{BTreeMap, HashMap, HashSet};

use rayon::prelude::*;

use crate::image::{Header, Image, ImageError, Srgb, read_header, srgb_to_linear};

use super::budget::DecodeBudget;
use super::entries::{Entry, stem};
use super::layout::Layout;
use super::photograph::{Assessment, CaptureView, CaptureWarning};

/// Below this many a capture is accepted with a warning.
pub const FEW_VIEWS: usize = 12;

/// Long side at which photographs are assessed, px: decoding dominates, so small is enough.
const ASSESSED_SIDE: usize = 320;

/// Photographs decoded at a time. Each holds its full size in 8 or 16 bit; the budget bounds what
/// that comes to.
const DECODED_AT_ONCE: usize = 2;

/// Smallest side of a photograph: below it COLMAP finds hardly a feature.
const SMALLEST_SIDE: usize = 64;

/// A mean V below this share of white, sRGB, leaves a few grey levels of an 8-bit file.
const DARK_MEAN_V: f32 = 0.02;

/// A photograph this much less sharp than the capture's middle one is called blurred.
const BLURRED_SHARE: f32 = 0.35;

/// Why a video beside photographs is not used.
const UNUSED_VIDEO: &str = "a video; one that is given by itself is taken apart into photographs";

/// Longest of our own names.
const LONGEST_NAME: usize = 40;

/// The outcome for the whole capture.
pub(super) struct Assessed {
    pub(super) views: Vec<CaptureView>,
    pub(super) assessments: Vec<Assessment>,
    pub(super) warnings: Vec<CaptureWarning>,
}

/// What was seen in one photograph.
struct Seen {
    header: Header,
    /// blake3 of the small picture: equal pictures are equal whatever wraps them.
    picture: [u8; 32],
    mean_v: f32,
    /// Gradient energy relative to brightness: comparable within one capture only.
    sharpness: f32,
}

/// Assesses every photograph, then the capture.
pub(super) fn assess(layout: &Layout, budget: &DecodeBudget) -> Assessed {
    let seen = look_at_all(&layout.photographs, budget);
    let typical = median(seen.iter().flatten().map(|seen| seen.sharpness).collect());
    let mut assessed = Assessed {
        views: Vec::new(),
        assessments: Vec::new(),
        warnings: Vec::new(),
    };
    let (mut pictures, mut names) = (HashMap::new(), Names::default());
    for (entry, seen) in layout.photographs.iter().zip(seen) {
        let seen = seen.and_then(|seen| match pictures.insert(seen.picture, entry.name()) {
            Some(first) => Err(Fault::of(format!("the same picture as {first}"))),
            None => Ok(seen),
        });
        match seen {
            Ok(seen) => {
                let warnings = seen.warnings(typical);
                let name = names.own(stem(entry.name()));
                assessed.accept(entry, &seen.header, name, warnings);
            }
            Err(fault) => assessed.assessments.push(fault.assessment(entry)),
        }
    }
    let unused = |entry| Fault::of(UNUSED_VIDEO.to_owned()).assessment(entry);
    assessed
        .assessments
        .extend(layout.videos.iter().map(unused));
    assessed.attach_ground_truth(&layout.ground_truth, budget);
    assessed.warn_of_the_whole();
    assessed
}

fn look_at_all(photographs: &[Entry], budget: &DecodeBudget) -> Vec<Result<Seen, Fault>> {
    let look = |entry| look_at(entry, budget);
    on_few_threads(|| photographs.par_iter().map(look).collect())
}

/// Runs parallel work on so few threads that decoded photographs stay within bounds.
fn on_few_threads<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new()
        .num_threads(DECODED_AT_ONCE)
        .build()
    {
        Ok(pool) => pool.install(work),
        // No threads of its own to be had: the shared ones do it.
        Err(_) => work(),
    }
}

/// Why a photograph is not used.
struct Fault {
    reason: String,
    unsupported_format: bool,
    header: Option<Header>,
}

impl Fault {
    fn of(reason: String) -> Self {
        Self {
            reason,
            unsupported_format: false,
            header: None,
        }
    }

    fn assessment(self, entry: &Entry) -> Assessment {
        Assessment {
            name: entry.name().to_owned(),
            accepted: false,
            reason: Some(self.reason),
            unsupported_format: self.unsupported_format,
            width: self.header.as_ref().map_or(0, |header| header.width),
            height: self.header.as_ref().map_or(0, |header| header.height),
            focal_px: self.header.and_then(|header| header.focal_px),
            warnings: Vec::new(),
        }
    }
}

impl From<ImageError> for Fault {
    fn from(error: ImageError) -> Self {
        let reason = match &error {
            // The path would be one of ours.
            ImageError::Io { source, .. } => format!("cannot be read: {source}"),
            error => error.to_string(),
        };
        Self {
            unsupported_format: error.is_unsupported_format(),
            ..Self::of(reason)
        }
    }
}

fn look_at(entry: &Entry, budget: &DecodeBudget) -> Result<Seen, Fault> {
    let header = read_header(&entry.file)?;
    let reject = |reason: String| {
        Err(Fault {
            header: Some(header.clone()),
            ..Fault::of(reason)
        })
    };
    if header.width.min(header.height) < SMALLEST_SIDE {
        return reject(format!(
            "{} x {} px: each side must have at least {SMALLEST_SIDE}",
            header.width, header.height
        ));
    }
    let share = budget.take(header.decoded_bytes);
    let small = match Image::load_at_most(&entry.file, ASSESSED_SIDE) {
        Ok(small) => small,
        Err(error) => {
            return Err(Fault {
                header: Some(header),
                ..Fault::from(error)
            });
        }
    };
    drop(share);
    let bytes: Vec<u8> = small.data().iter().flat_map(|v| v.to_le_bytes()).collect();
    let v = small.pixels();
    let mean_v = (0..v).map(|i| largest(&small, i)).sum::<f32>() / v as f32;
    let (low, high) = small
        .data()
        .iter()
        .fold((f32::MAX, f32::MIN), |(l, h), &v| (l.min(v), h.max(v)));
    if high - low < 1.5 / 255.0 {
        let colour = if high < 1.5 / 255.0 {
            "black"
        } else {
            "one colour"
        };
        return reject(format!("nothing is seen: the whole picture is {colour}"));
    }
    let sharpness = sharpness(&small);
    Ok(Seen {
        header,
        picture: *blake3::hash(&bytes).as_bytes(),
        mean_v,
        sharpness,
    })
}

fn largest(image: &Image<Srgb>, i: usize) -> f32 {
    image.plane(0)[i]
        .max(image.plane(1)[i])
        .max(image.plane(2)[i])
}

/// Mean squared gradient of linear luma over the squared mean: independent of exposure. At a
/// long side of 320 px most of the noise is averaged away in photographs of usual size.
fn sharpness(small: &Image<Srgb>) -> f32 {
    let luma: Vec<f32> = small.luma().into_iter().map(srgb_to_linear).collect();
    let (width, height) = (small.width(), small.height());
    let mean = (luma.iter().sum::<f32>() / luma.len() as f32).max(1e-6);
    let mut energy = 0.0;
    for y in 0..height - 1 {
        for x in 0..width - 1 {
            let here = luma[y * width + x];
            let (dx, dy) = (
                luma[y * width + x + 1] - here,
                luma[(y + 1) * width + x] - here,
            );
            energy += f64::from(dx * dx + dy * dy);
        }
    }
    energy as f32 / luma.len() as f32 / (mean * mean)
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

impl Seen {
    fn warnings(&self, typical_sharpness: f32) -> Vec<CaptureWarning> {
        let mut warnings = Vec::new();
        if self.mean_v < DARK_MEAN_V {
            let levels = self.mean_v * 255.0;
            warnings.push(CaptureWarning::new(
                "dark",
                format!("very dark: the mean level is {levels:.1} of 255, most detail is noise"),
            ));
        }
        if self.sharpness < BLURRED_SHARE * typical_sharpness {
            let share = 100.0 * self.sharpness / typical_sharpness;
            warnings.push(CaptureWarning::new(
                "blurred",
                format!("much more blurred than the others: {share:.0} % of the usual sharpness"),
            ));
        }
        warnings
    }
}

impl Assessed {
    fn accept(
        &mut self,
        entry: &Entry,
        header: &Header,
        name: String,
        warnings: Vec<CaptureWarning>,
    ) {
        let &Header {
            width,
            height,
            focal_px,
            ..
        } = header;
        self.assessments.push(Assessment {
            name: entry.name().to_owned(),
            accepted: true,
            reason: None,
            unsupported_format: false,
            width,
            height,
            focal_px,
            warnings,
        });
        self.views.push(CaptureView {
            name,
            original_name: entry.name().to_owned(),
            file: entry.file.clone(),
            width,
            height,
            focal_px,
            gt: None,
        });
    }

    /// Gives each view the ground truth of its stem, where that has the view's shape.
    fn attach_ground_truth(
        &mut self,
        ground_truth: &BTreeMap<String, Entry>,
        budget: &DecodeBudget,
    ) {
        if ground_truth.is_empty() {
            return;
        }
        let find = |view: &CaptureView| {
            ground_truth
                .get(&stem(&view.original_name).to_lowercase())
                .map(|entry| (entry, is_truth_of(view, entry, budget)))
        };
        let found: Vec<_> = on_few_threads(|| self.views.par_iter().map(find).collect());
        let (mut missing, mut unusable) = (Vec::new(), Vec::new());
        for (view, found) in self.views.iter_mut().zip(found) {
            match found {
                Some((entry, true)) => view.gt = Some(entry.file.clone()),
                Some((_, false)) => unusable.push(&*view.original_name),
                None => missing.push(&*view.original_name),
            }
        }
        let mut warn = |code: &str, what: &str, names: &[&str]| {
            if let Some(first) = names.first() {
                let message = format!("{} photographs {what}, the first is {first}", names.len());
                self.warnings.push(CaptureWarning::new(code, message));
            }
        };
        warn("gt_missing", "have no ground truth", &missing);
        warn(
            "gt_size",
            "have ground truth that cannot be read or has another shape",
            &unusable,
        );
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
            self.warnings
                .push(CaptureWarning::new("mixed_sizes", message));
        }
    }
}

/// Whether ground truth has a view's proportions, within 1 %, and is whole: a broken one must
/// show now, not when the scene is measured.
fn is_truth_of(view: &CaptureView, entry: &Entry, budget: &DecodeBudget) -> bool {
    let Ok(header) = read_header(&entry.file) else {
        return false;
    };
    let ratio = (header.width * view.height) as f64 / (header.height * view.width) as f64;
    let _share = budget.take(header.decoded_bytes);
    (ratio - 1.0).abs() < 0.01 && Image::load_at_most(&entry.file, ASSESSED_SIDE).is_ok()
}

/// Our own names for the accepted photographs of these names, in the order of their assessments.
pub fn view_names<'a>(accepted: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut names = Names::default();
    accepted.map(|name| names.own(stem(name))).collect()
}

/// The names given so far, in lower case.
#[derive(Default)]
struct Names {
    taken: HashSet<String>,
    /// The last number behind a name. It only grows, so that thousands of equal names cost no more
    /// than different ones.
    numbers: HashMap<String, u32>,
}

impl Names {
    /// Our own name for a view: the stem with everything else than letters, digits, `-` and `_`
    /// replaced, never empty, never starting like an option, unique also where case is ignored.
    fn own(&mut self, stem: &str) -> String {
        let safe = |c: char| {
            if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') {
                c
            } else {
                '_'
            }
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
        fn any_names_become_safe_and_different(stems in prop::collection::vec(".{0,60}", 1..20)) {
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
