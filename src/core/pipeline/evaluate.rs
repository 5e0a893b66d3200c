//! The scores of a round, its pictures at the target brightness, and its scene there.

mod by_view;
mod images;
mod records;
mod score;

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::config::Deliver;
use super::context::Context;
use super::enhance::Brightening;
use super::error::PipelineError;
use super::match_brightness::Next;
use super::pictures;
use super::reconstruct::TrainedScene;
use super::report;
use super::round::Round;
use super::tone::Tone;
use super::views::View;
use super::workspace::Workspace;
use crate::camera::normalisation::Normalisation;
use crate::event::Stage;
use crate::gaussians::ply;
use crate::image::{EncodeFormat, Image};
use crate::metrics::{self, RoundMetrics};
use images::TargetImages;

pub use images::RoundImages;
pub use score::Likeness;

/// Loss of score beyond which a round counts as worse than the previous one, dB.
const WORSE_BY: f64 = 0.05;

/// A finished round.
#[derive(Clone, Copy)]
pub struct Finished<'a> {
    pub round: &'a Round,
    /// The views, with their ground truth where the capture has it.
    pub views: &'a [View],
    /// The photographs that have no pose.
    pub unregistered: &'a [String],
    /// H_i, D_i and R_i.
    pub images: RoundImages<'a>,
    /// V_i.
    pub scene: &'a TrainedScene,
    /// The results handed to the next round; `None` for the last round.
    pub next: Option<&'a Next>,
    /// From the world of the poses to the scene's.
    pub normalisation: &'a Normalisation,
    /// Which round is delivered.
    pub deliver: Deliver,
}

/// Runs the stage: the round's row of `metrics.json`. `restored/` holds the pictures of the round
/// that is delivered if none follows; `before` are the earlier rows.
///
/// # Errors
/// [`PipelineError::Io`], [`PipelineError::Ply`], [`PipelineError::Cancelled`].
pub fn evaluate(
    context: &mut Context<'_>,
    finished: &Finished<'_>,
    brightening: &Brightening,
    before: &[RoundMetrics],
) -> Result<RoundMetrics, PipelineError> {
    let number = finished.round.number;
    let metrics = context.stage(Stage::Evaluate, number, |context| {
        let tone = finished.next.map(|next| &next.to_target);
        let target = TargetImages { enhanced: &brightening.target, images: finished.images, tone };
        let metrics = measure(finished, &target, brightening, before.last());
        let rounds = [before, std::slice::from_ref(&metrics)].concat();
        if report::delivered_round(&rounds, finished.deliver) == number {
            restored(context.workspace, finished.views, &target)?;
        }
        brighten_scene(context.workspace, tone, finished)?;
        Ok(metrics)
    })?;
    // The stage's time is known only after it ends.
    let seconds = context.clock.round(number);
    Ok(RoundMetrics { seconds, ..metrics })
}

/// Writes the round's scene at the target brightness, which is delivered if no later round is
/// better. The last round is at that brightness already; its call removes a file that a run with
/// more rounds may have left.
fn brighten_scene(
    workspace: &Workspace,
    tone: Option<&Tone>,
    finished: &Finished<'_>,
) -> Result<(), PipelineError> {
    let round = workspace.folder().round(finished.round.number);
    let path = round.scene_at_target();
    let Some(tone) = tone else {
        return workspace.remove(&path);
    };
    let mut gaussians = finished.scene.gaussians.clone();
    let curve = tone.scene();
    gaussians.map_colours(|rgb| curve.apply_colour(rgb), |rgb| curve.slope(rgb));
    Ok(ply::write(&gaussians, finished.normalisation, &path)?)
}

/// Writes the round's renders at the views' cameras and the target brightness, with 16 bits: a
/// scene averages its views, and people go on editing these.
fn restored(
    workspace: &Workspace,
    views: &[View],
    target: &TargetImages<'_>,
) -> Result<(), PipelineError> {
    views.iter().enumerate().try_for_each(|(index, view)| {
        let path = workspace.folder().restored_view(&view.name);
        pictures::write(workspace, &path, &target.render(index), EncodeFormat::Png16)
    })
}

fn measure(
    finished: &Finished<'_>,
    target: &TargetImages<'_>,
    brightening: &Brightening,
    previous: Option<&RoundMetrics>,
) -> RoundMetrics {
    let Finished { round, views, unregistered, images, scene, next, .. } = finished;
    let noise_sigma = means(images, metrics::noise_sigma);
    let sigma = noise_sigma.get("enhanced").copied().unwrap_or_default();
    let response = &brightening.last().response;
    let likeness = |index: usize| {
        let (render, mask) = (target.render(index), views[index].mask.as_ref());
        Likeness::of(&render, &target.enhanced[index], mask, response)
    };
    let likenesses: Vec<Likeness> = (0..views.len()).into_par_iter().map(likeness).collect();
    let score = score::score(views, &likenesses);
    let comparisons = records::comparisons(views, target);
    let before = previous.and_then(|previous| previous.score);
    let matched = next.map_or(&[][..], |next| &next.matched);
    let training = &scene.training;
    RoundMetrics {
        round: round.number,
        seconds: 0.0,
        gaussians: scene.gaussians.len() as u64,
        steps: training.steps,
        steps_per_second: training.steps_per_second,
        between: training.between,
        sharpness: means(images, metrics::sharpness),
        mean_brightness: mean(images.enhanced, metrics::mean_v),
        clipped: mean(images.enhanced, metrics::clipped_share),
        noise_ceiling_db: metrics::noise_ceiling(sigma),
        noise_sigma,
        records: records::records(views, &comparisons),
        views: by_view::rows(views, unregistered, &comparisons, &likenesses),
        noise_map: training.noise,
        expected_noise: training.expected_noise,
        lowered_cap: training.lowered_cap,
        kernels: training.kernels,
        shake_px: training.shake_px,
        pose_correction_px: training.pose_correction_px,
        non_finite_gradients: training.non_finite_gradients,
        anchor: round.anchor,
        matched: matched.to_vec(),
        score: Some(score),
        worse_than_previous: before.is_some_and(|before| score < before - WORSE_BY),
    }
}

/// Means of a measure over the enhanced views, the deblurred views and the renders.
fn means(
    images: &RoundImages<'_>,
    measure: impl Fn(&Image) -> f64 + Sync + Send + Copy,
) -> BTreeMap<String, f64> {
    [("enhanced", images.enhanced), ("deblurred", images.deblurred), ("render", images.renders)]
        .into_iter()
        .map(|(name, set)| (name.to_owned(), mean(set, measure)))
        .collect()
}

/// Mean of a measure over images.
fn mean(images: &[Image], measure: impl Fn(&Image) -> f64 + Sync + Send) -> f64 {
    images.par_iter().map(measure).collect::<Vec<_>>().iter().sum::<f64>() / images.len() as f64
}
