//! Determines which photographs have usable masks, and how much these leave.

use rayon::prelude::*;

use super::entries::Entry;
use super::look::{Assessor, Fault, Seen, on_few_threads};
use super::masks::Masks;
use super::photograph::{CaptureView, CaptureWarning};
use crate::image::{Header, ImageError};
use crate::mask::{Mask, Masking};

/// Long side at which masks are assessed, px: the same as for photographs.
const ASSESSED_SIDE: usize = 320;

/// Below this share of the pixels nothing useful is left.
const LEAST_LEFT: f64 = 0.001;

/// The masks of one photograph.
#[derive(Default)]
pub(super) struct Masked {
    /// The usable ones.
    pub(super) masking: Option<Masking>,
    /// Whether they hide the whole photograph.
    hides_all: bool,
    /// Unusable masks, with the reasons.
    faults: Vec<(String, ImageError)>,
}

impl Masked {
    /// Why the photograph is not used.
    pub(super) fn fault(&self) -> Option<Fault> {
        self.hides_all.then(|| Fault::of("its mask hides all of it".to_owned()))
    }

    fn of(entry: &Entry, header: &Header, masks: &Masks, assessor: &Assessor<'_>) -> Self {
        let most = header.width.max(header.height).max(ASSESSED_SIDE);
        let small = |side: usize| (side * ASSESSED_SIDE / most).max(1);
        let size = (small(header.width), small(header.height));
        let none = Masking { alpha: false, ..Masking::of(&entry.file) };
        let mut own = Self::default();
        let (mut all, mut left) = (none.clone(), Mask::full(size.0, size.1));
        for (mask, picture) in masks.of(&entry.path) {
            let alone = Masking { pictures: vec![picture.clone()], ..none.clone() };
            match assessor.decoding(mask, || alone.load(size, Clone::clone)) {
                Ok(pixels) => {
                    left = left.and(&pixels);
                    all.pictures.push(picture.clone());
                }
                Err(error) => own.faults.push((mask.path.to_string(), error)),
            }
        }
        if header.has_alpha {
            let alone = Masking::of(&entry.file);
            // The photograph has already been decoded.
            if let Ok(pixels) = assessor.decoding(entry, || alone.load(size, Clone::clone)) {
                all.alpha = pixels.share() < 1.0;
                left = left.and(&pixels);
            }
        }
        own.hides_all = left.share() < LEAST_LEFT;
        own.masking = (all != none).then_some(all);
        own
    }
}

/// Looks at the masks of each readable photograph.
pub(super) fn look_at_masks(
    photographs: &[Entry],
    seen: &[Result<Seen, Fault>],
    masks: &Masks,
    assessor: &Assessor<'_>,
) -> Vec<Masked> {
    let all = photographs.par_iter().zip(seen);
    let of = |(entry, seen): (&Entry, &Result<Seen, Fault>)| match seen {
        Ok(seen) => Masked::of(entry, &seen.header, masks, assessor),
        Err(_) => Masked::default(),
    };
    on_few_threads(|| all.map(of).collect())
}

/// The warnings about the masks of these photographs.
pub(super) fn warnings(views: &[CaptureView], masked: &[Masked]) -> Vec<CaptureWarning> {
    let mut warnings = Vec::new();
    let faults: Vec<_> = masked.iter().flat_map(|masked| &masked.faults).collect();
    if let Some((first, error)) = faults.first() {
        let message = format!("{} masks are not used, the first is {first}: {error}", faults.len());
        warnings.push(CaptureWarning::new("masks", message));
    }
    let hidden = masked.iter().filter(|masked| masked.hides_all).count();
    if hidden > 0 {
        let message = format!(
            "{hidden} photographs are not used, because their masks hide all of them: black hides, \
             white does not"
        );
        warnings.push(CaptureWarning::new("masks", message));
    }
    let count = views.iter().filter(|view| view.masking.is_some()).count();
    if count > 0 {
        let message = format!(
            "{count} of {} photographs have masks: masked and transparent pixels are ignored by \
             poses, training and scores",
            views.len()
        );
        warnings.push(CaptureWarning::new("masks", message));
    }
    warnings
}
