//! Refines given poses: phones record approximate poses, a few degrees and per cent off.
//!
//! Poses are found as for any capture, by matches and bundle adjustment, and transformed to the
//! given world, whose scale and axes stay. If the given ones fit the matches as well, they are
//! kept.

use super::candidate::Evidence;
use super::consistency::Consistency;
use super::copies::Copies;
use super::search::Search;
use crate::cancel::CancelToken;
use crate::event::ProgressSink;
use crate::poses::align::Similarity;
use crate::poses::model::{ModelCamera, ModelImage, SparseModel};
use crate::poses::{Lens, PoseStatus, PoseView, PosedView, Poses, PosesError};

/// Given poses that fit this share of the matches that the found ones fit are as good: the found
/// ones were optimised to fit them.
const AS_GOOD: f64 = 0.9;

impl Search<'_> {
    /// Poses in the world of the `given` ones, for all views that have one or were found; `None` if
    /// the given ones are kept.
    pub fn refine(
        &self,
        given: &[PosedView],
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Option<Poses>, PosesError> {
        let small = self.small_copies(sink, cancel)?;
        let mut evidence = Evidence { small: &small, found: None };
        let unchecked = |why: &str, sink: &mut dyn ProgressSink| {
            let message = format!("the given poses were not refined: {why}");
            sink.warn("poses_unrefined", message);
            Ok(None)
        };
        let Some(best) = self.best(&mut evidence, sink, cancel)? else {
            return unchecked("no poses were found to compare them with", sink);
        };
        let poses = self.deliver(&best, &evidence)?;
        let (Some(matches), Some(found), false) =
            (&evidence.found, &best.consistency, poses.low_confidence)
        else {
            return unchecked("the poses that were found are not reliable", sink);
        };
        let model = model_of(given, self.request.views, &small);
        let fits = Consistency::of(&model, &small, &small, matches).share();
        let stand = fits >= AS_GOOD * found.share();
        sink.log(format!(
            "poses: {:.0} % of the matches fit the given poses, {:.0} % the found ones: {}",
            100.0 * fits,
            100.0 * found.share(),
            if stand { "the given ones are kept" } else { "they are refined" }
        ));
        if stand {
            return Ok(None);
        }
        let placed = |view: &PosedView| given.iter().find(|given| given.name == view.name);
        let both = poses.views.iter().filter_map(|view| Some((view, placed(view)?)));
        let (from, to): (Vec<_>, Vec<_>) =
            both.map(|(view, given)| (view.camera, given.camera)).unzip();
        let Some(world) = Similarity::between(&from, &to) else {
            return unchecked(
                "fewer than three of the photographs were also placed by the search",
                sink,
            );
        };
        Ok(Some(in_world(poses, &world, given, self.request.views)))
    }
}

/// Found poses in the given world, and the given poses of views that were not found.
fn in_world(poses: Poses, world: &Similarity, given: &[PosedView], all: &[PoseView]) -> Poses {
    let mut poses = poses;
    for view in &mut poses.views {
        view.camera = world.camera(&view.camera);
    }
    for point in &mut poses.points {
        point.position = world.apply(point.position.into()).to_array();
    }
    for view in given {
        if poses.views.iter().all(|found| found.name != view.name) {
            poses.views.push(view.clone());
            poses.verdict_of(&view.name).status = PoseStatus::Given;
        }
    }
    // The given poses connect views that no matches connect.
    poses.parts.clear();
    poses.views.sort_by_key(|view| all.iter().position(|asked| asked.name == view.name));
    poses.registered = poses.views.len();
    poses
}

/// The given poses as a model without points, at the size of the copies.
fn model_of(given: &[PosedView], views: &[PoseView], copies: &Copies) -> SparseModel {
    let mut model = SparseModel::default();
    for (view, id) in given.iter().zip(1_u32..) {
        let Some(index) = views.iter().position(|asked| asked.name == view.name) else {
            continue;
        };
        let copy = &copies.copies[index];
        let lens = Lens {
            intrinsics: view.lens.intrinsics.resized(copy.size.0, copy.size.1),
            ..view.lens
        };
        model.cameras.push(ModelCamera::of_lens(id, &lens));
        model.images.push(ModelImage::posed(id, id, copy.file.clone(), &view.camera));
    }
    model
}
