//! The resolution of a part of a round.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use fled_gpu::{Gpu, GpuError};

use super::loss::Loss;
use super::observed::Observed;

/// One divisor of the images, and a loss for each resulting size.
pub(super) struct Level {
    /// 4, 2 or 1.
    pub(super) divisor: usize,
    losses: BTreeMap<[usize; 2], Loss>,
}

impl Level {
    /// The level for `views` already reduced by `divisor`.
    pub(super) fn new(gpu: &Gpu, views: &[Observed<'_>], divisor: usize) -> Result<Self, GpuError> {
        let mut losses = BTreeMap::new();
        for [width, height] in views.iter().map(Observed::size) {
            if let Entry::Vacant(entry) = losses.entry([width, height]) {
                let loss = Loss::new(gpu, width, height)?;
                let of_size = views.iter().filter(|view| view.size() == [width, height]);
                let has_masks = { of_size }.any(|view| view.given().mask.is_some());
                entry.insert(if has_masks { loss.with_masks(gpu)? } else { loss });
            }
        }
        Ok(Self { divisor, losses })
    }

    /// The loss for a view's size.
    pub(super) fn loss(&self, view: &Observed<'_>) -> &Loss {
        &self.losses[&view.size()]
    }
}
