//! The result of a strategy, and which part of it is trusted.

use std::collections::HashSet;

use super::consistency::Consistency;
use super::copies::Copies;
use super::groups;
use super::strategies::FIRST_LEARNED;
use crate::camera::Camera;
use crate::poses::matching::Correspondences;
use crate::poses::model::SparseModel;
use crate::poses::{Lens, PoseStatus, PoseVerdict, PoseView, PosedView, SparsePoint};

/// A strategy's result.
pub(super) struct Candidate {
    pub(super) strategy: char,
    pub(super) model: SparseModel,
    pub(super) copies: Copies,
    /// How the learned matches agree with the model, if there are any.
    pub(super) consistency: Option<Consistency>,
    pub(super) accepted: bool,
}

impl Candidate {
    /// Ranks candidates, most important criterion first.
    pub(super) fn rank(&self) -> (bool, usize, u64) {
        (self.accepted, self.believed(), self.exactness())
    }

    /// Observations per photograph over the square of their mean error, in millionths: inversely
    /// proportional to the variance of a position. Four fifths for learned points, as COLMAP's are
    /// finer than their error suggests.
    fn exactness(&self) -> u64 {
        let observations = self.model.observations() as f64 / self.model.images.len() as f64;
        let error = self.model.mean_error().unwrap_or(f64::MAX).max(1e-3);
        let share = if self.strategy >= FIRST_LEARNED { 0.8 } else { 1.0 };
        (1e6 * share * observations / (error * error)) as u64
    }

    /// The trusted views, in order, at the originals' sizes.
    pub(super) fn placed(&self, views: &[PoseView]) -> Vec<PosedView> {
        let all = views.iter().zip(&self.copies.copies).enumerate();
        let believed = all.filter(|(index, _)| self.believes(*index));
        let placed = believed.filter_map(|(_, (view, copy))| {
            let images = &self.model.images;
            let image = images.iter().find(|image| image.name == copy.file)?;
            let lens = self.model.camera_of(image).lens();
            let (width, height) = copy.original;
            let lens = Lens { intrinsics: lens.intrinsics.resized(width, height), ..lens };
            let camera =
                Camera { intrinsics: lens.pinhole(), world_to_camera: image.world_to_camera() };
            Some(PosedView { name: view.name.clone(), camera, lens })
        });
        placed.collect()
    }

    fn believes(&self, index: usize) -> bool {
        let consistency = self.consistency.as_ref();
        consistency.is_none_or(|of| of.believed().contains(&index))
    }

    /// The verdict on a photograph's pose.
    pub(super) fn verdict(&self, index: usize, view: &PoseView) -> PoseVerdict {
        let file = &self.copies.copies[index].file;
        let is_placed = self.model.images.iter().any(|image| image.name == *file);
        let consistency = self.consistency.as_ref();
        let is_believed = self.believes(index);
        let (matches, fitting) = consistency.map_or((0, 0), |of| of.matches_of(index));
        PoseVerdict {
            name: view.name.clone(),
            status: match (is_placed, is_believed) {
                (true, true) => PoseStatus::Registered,
                (true, false) => PoseStatus::Doubtful,
                (false, _) => PoseStatus::NotFound,
            },
            matches,
            fitting,
            error_px: self.model.error_of(file),
            fit: None,
        }
    }

    /// The points seen by at least two trusted photographs.
    pub(super) fn points(&self) -> Vec<SparsePoint> {
        let Some(consistency) = &self.consistency else {
            return self.model.sparse_points();
        };
        let files: HashSet<&str> = consistency
            .believed()
            .iter()
            .map(|&index| self.copies.copies[index].file.as_str())
            .collect();
        let believed: HashSet<u32> = self
            .model
            .images
            .iter()
            .filter(|image| files.contains(image.name.as_str()))
            .map(|image| image.id)
            .collect();
        let mut model = self.model.clone();
        model.points.retain_mut(|point| {
            point.track.retain(|(image, _)| believed.contains(image));
            point.track.len() > 1
        });
        model.sparse_points()
    }

    /// Number of photographs with a trusted pose.
    pub(super) fn believed(&self) -> usize {
        self.consistency.as_ref().map_or(self.model.images.len(), |of| of.believed().len())
    }
}

/// The small copies, and what the networks found in them.
pub(super) struct Evidence<'a> {
    pub(super) small: &'a Copies,
    pub(super) found: Option<Correspondences>,
}

impl Evidence<'_> {
    /// The most photographs that a model can be believed to place: [`Consistency`] believes what
    /// pairs of the networks' matches connect. `None` if the networks found nothing.
    pub(super) fn reach(&self) -> Option<usize> {
        let groups = groups::connected(self.found.as_ref()?);
        Some(groups.first().map_or(0, Vec::len))
    }

    /// Like [`Evidence::reach`], of pairs that clearly show one place.
    pub(super) fn clear_reach(&self) -> Option<usize> {
        let groups = groups::clearly_connected(self.found.as_ref()?);
        Some(groups.first().map_or(0, Vec::len))
    }
}
