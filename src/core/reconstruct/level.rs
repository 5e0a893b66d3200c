//! The training views at one resolution, on the device.

use std::collections::BTreeMap;

use fled_gpu::{Buffer, Gpu, GpuError};

use super::TrainingView;
use super::loss::{Loss, pack_target, upload_target};
use super::schedule::reduced_size;
use crate::camera::Camera;
use crate::image::Image;

/// One view at the level's resolution.
pub(super) struct LevelView {
    /// At the reduced size.
    pub(super) camera: Camera,
    /// Packed image.
    pub(super) target: Buffer<u32>,
    size: (usize, usize),
}

/// All views reduced by one divisor.
pub(super) struct Level {
    /// 4, 2 or 1.
    pub(super) divisor: usize,
    /// In the order of the training views.
    pub(super) views: Vec<LevelView>,
    losses: BTreeMap<(usize, usize), Loss>,
}

impl Level {
    /// Reduces the views by area averaging and uploads them.
    pub(super) fn new(gpu: &Gpu, views: &[TrainingView], divisor: usize) -> Result<Self, GpuError> {
        let mut losses = BTreeMap::new();
        let mut reduced = Vec::with_capacity(views.len());
        for view in views {
            let size = reduced_size(view.image.width(), view.image.height(), divisor);
            let target = upload_target(gpu, &view.image.resize_area(size.0, size.1))?;
            reduced.push(LevelView {
                camera: view.camera.resized(size.0, size.1),
                target,
                size,
            });
            if let std::collections::btree_map::Entry::Vacant(entry) = losses.entry(size) {
                entry.insert(Loss::new(gpu, size.0, size.1)?);
            }
        }
        Ok(Self {
            divisor,
            views: reduced,
            losses,
        })
    }

    /// Trains `view` on another image of its size.
    pub(super) fn show(&self, view: usize, image: &Image) -> Result<(), GpuError> {
        self.views[view].target.write(&pack_target(image))
    }

    /// The loss that fits a view.
    pub(super) fn loss(&self, view: usize) -> &Loss {
        &self.losses[&self.views[view].size]
    }
}
