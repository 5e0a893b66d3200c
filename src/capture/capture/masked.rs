//! Determines which photographs have usable masks, and how much these leave.

use rayon::prelude::*;

use super::entries::Entry;
use super::look::{Assessor, Fault, Seen, on_few_threads};
use super::masks::Masks;
use super::photograph::{CaptureView, CaptureWarning};
use super::prepared::PreparedImage;
use crate::image::shares;
use crate::image::{Header, ImageError, at_most};
use crate::mask::Mask;

/// Long side at which masks are assessed, px: the same as for photographs.
const ASSESSED_SIDE: usize = 320;

/// Below this share of the pixels nothing useful is left.
const LEAST_LEFT: f64 = 0.001;

/// The masks of one photograph.
#[derive(Default)]
pub(super) struct Masked {
    /// How much each pixel counts, if there are usable ones.
    pub(super) mask: Option<PreparedImage>,
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

    fn of(
        index: usize,
        entry: &Entry,
        header: &Header,
        masks: &Masks,
        assessor: &Assessor<'_>,
    ) -> Self {
        let mut own = Self::default();
        let mut all = Vec::new();
        for (mask, picture) in masks.of(&entry.path) {
            match assessor.decoding(mask, || picture.shares(header)) {
                Ok(shares) => all.push(shares),
                Err(error) => own.faults.push((mask.path.to_string(), error)),
            }
        }
        if header.has_alpha {
            // The photograph has already been decoded.
            let alpha = assessor.decoding(entry, || shares::of_alpha(&entry.file));
            all.extend(alpha.ok().flatten());
        }
        if all.is_empty() {
            return own;
        }
        let (width, height) = at_most(header.width, header.height, ASSESSED_SIDE);
        let left = all.iter().map(|shares| Mask::of_shares(&shares.at(width, height)));
        let left = left.fold(Mask::full(width, height), |left, mask| left.and(&mask));
        own.hides_all = left.share() < LEAST_LEFT;
        own.mask = assessor.prepared_mask(index, header, &all);
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
    let all = photographs.par_iter().zip(seen).enumerate();
    let of = |(index, (entry, seen)): (usize, (&Entry, &Result<Seen, Fault>))| match seen {
        Ok(seen) => Masked::of(index, entry, &seen.header, masks, assessor),
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
    let count = views.iter().filter(|view| view.mask.is_some()).count();
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
