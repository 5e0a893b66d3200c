//! Determines which photographs have usable masks, and how much these leave.

use rayon::prelude::*;

use super::entries::Entry;
use super::look::{ASSESSED_SIDE, Assessor, Fault, Seen, on_few_threads};
use super::masks::Masks;
use super::photograph::{CaptureView, CaptureWarning};
use super::prepared::PreparedImage;
use crate::image::shares::{self, Shares};
use crate::image::{Header, Image, ImageError, Linear, at_most};
use crate::mask::Mask;

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
    /// Removes the mask of a photograph that is not used.
    pub(super) fn discard(&self) {
        self.mask.iter().for_each(PreparedImage::remove);
    }

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
        let mut all = Counted::of(header, assessor.prepared_side());
        let upright = (header.width, header.height);
        for (mask, picture) in masks.of(&entry.path) {
            let read = || picture.shares(header.orientation, upright).map(|one| all.add(&one));
            if let Err(error) = assessor.decoding(mask, read) {
                own.faults.push((mask.path.to_string(), error));
            }
        }
        if header.has_alpha {
            let read = || shares::of_alpha(&entry.file).map(|alpha| alpha.map(|one| all.add(&one)));
            // The photograph has already been decoded.
            let _ = assessor.decoding(entry, read);
        }
        if all.count > 0 {
            own.hides_all = all.left.share() < LEAST_LEFT;
            own.mask =
                (!own.hides_all).then(|| assessor.prepared_mask(index, &all.least)).flatten();
        }
        own
    }
}

/// The pixels of a photograph that its masks leave visible.
struct Counted {
    /// Number of masks.
    count: usize,
    /// At a small size, to measure.
    left: Mask,
    /// The least share of each pixel of the prepared image.
    least: Image<Linear>,
}

impl Counted {
    fn of(header: &Header, side: usize) -> Self {
        let (width, height) = at_most(header.width, header.height, ASSESSED_SIDE);
        let (wide, high) = at_most(header.width, header.height, side);
        let least = Image::<Linear>::new(wide, high).map(|_| 1.0);
        Self { count: 0, left: Mask::full(width, height), least }
    }

    fn add(&mut self, shares: &Shares) {
        self.count += 1;
        let [width, height] = self.left.size();
        self.left = self.left.and(&Mask::of_shares(&shares.at(width, height)));
        let other = shares.at(self.least.width(), self.least.height());
        let pairs = self.least.data_mut().iter_mut().zip(other.data());
        pairs.for_each(|(least, share)| *least = least.min(*share));
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
