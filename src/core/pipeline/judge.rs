//! R_i, P_R and the metrics of a round.

use rayon::prelude::*;

use super::config::LutScope;
use super::error::PipelineError;
use super::evaluate::{self, RoundImages};
use super::guide;
use super::job::Job;
use super::score;
use super::tone::Tone;
use super::training::Scene;
use super::views::View;
use crate::enhance::{self, Anchor, Histogram};
use crate::event::{Event, Stage};
use crate::gaussians::ply;
use crate::image::{EncodeFormat, Image};
use crate::metrics::{self, RoundMetrics};
use crate::render::Renderer;

/// File of a round's scene at the target brightness, where the round itself was darker.
pub const BRIGHTENED: &str = "scene_at_target.ply";

/// Views that share one search for the next brightness.
const MATCHED_VIEWS: usize = 6;

/// What a round hands to the next.
#[derive(Clone, Debug)]
pub struct Next {
    /// P_i, which this round was brightened to.
    anchor: Anchor,
    /// P_N.
    target: Anchor,
    /// The next round's views with the detail of HR; after the last round its renders themselves.
    pub guides: Vec<Image>,
    /// From this round's brightness to the next one's; `None` after the last round.
    pub to_next: Option<Tone>,
    /// From this round's brightness to the target's; `None` after the last round.
    to_final: Option<Tone>,
    /// The fitted anchors of `to_next`.
    matched: Vec<Anchor>,
}

impl Job<'_, '_> {
    /// R_i: the scene at every view's camera.
    pub fn render(
        &mut self,
        round: u32,
        views: &[View],
        scene: &Scene,
    ) -> Result<Vec<Image>, PipelineError> {
        self.stage(Stage::Render, round, |job| {
            let renderer = Renderer::new(job.tools.gpu);
            let uploaded = renderer.upload(&scene.gaussians)?;
            let mut renders = Vec::with_capacity(views.len());
            for (i, view) in views.iter().enumerate() {
                job.cancel.check()?;
                renders.push(
                    renderer
                        .render_scene(&uploaded, &view.camera)?
                        .map(|v| v.clamp(0.0, 1.0)),
                );
                job.advance(Stage::Render, round, i + 1, views.len());
            }
            job.previews(round, "renders", views, &renders)?;
            Ok(renders)
        })
    }

    /// P_R: the curves that bring this round's renders to the next round's brightness and to the
    /// target's.
    pub fn match_next(
        &mut self,
        round: u32,
        renders: &[Image],
        views: &[View],
        anchors: &[Anchor],
        target: &[Image],
    ) -> Result<Next, PipelineError> {
        let (anchor, target_anchor) = (anchors[round as usize - 1], anchors[anchors.len() - 1]);
        if round as usize == anchors.len() {
            return Ok(Next {
                anchor,
                target: target_anchor,
                guides: renders.to_vec(),
                to_next: None,
                to_final: None,
                matched: Vec::new(),
            });
        }
        self.stage(Stage::Match, round, |job| {
            let next = job.enhanced(views, anchors[round as usize]);
            let matched = job.fit(renders, &next);
            let scope = job.options.lut_scope;
            let to_next = Tone::fit(scope, renders, &matched);
            let to_final = if round as usize + 1 == anchors.len() {
                to_next.clone()
            } else {
                Tone::fit(scope, renders, &job.fit(renders, target))
            };
            Ok(Next {
                anchor,
                target: target_anchor,
                guides: guide::trusted(&next, &to_next.apply(renders)),
                to_next: Some(to_next),
                to_final: Some(to_final),
                matched,
            })
        })
    }

    /// The anchors for which E(R; P) looks like `wanted`: one search over a few views, or one a
    /// view.
    pub(super) fn fit(&self, renders: &[Image], wanted: &[Image]) -> Vec<Anchor> {
        let seed = self.options.seed;
        match self.options.lut_scope {
            LutScope::Scene => {
                let pairs: Vec<_> = enhance::spread_indices(renders.len(), MATCHED_VIEWS)
                    .into_iter()
                    .map(|i| (&renders[i], &wanted[i]))
                    .collect();
                vec![enhance::match_anchor(&pairs, &Histogram::pooled(renders), seed).anchor]
            }
            LutScope::Image => renders
                .par_iter()
                .zip(wanted)
                .map(|(render, wanted)| {
                    enhance::match_anchor(&[(render, wanted)], &Histogram::of(render), seed).anchor
                })
                .collect(),
        }
    }

    /// The round's row of `metrics.json`. `images` are H_i, D_i, R_i and H_N.
    pub fn evaluate(
        &mut self,
        round: u32,
        views: &[View],
        images: [&[Image]; 4],
        next: &Next,
        scene: &Scene,
    ) -> Result<(), PipelineError> {
        let [enhanced, deblurred, renders, final_enhanced] = images;
        let metrics = self.stage(Stage::Evaluate, round, |job| {
            let to_final = |images: &[Image]| match &next.to_final {
                Some(tone) => tone.apply(images),
                None => images.to_vec(),
            };
            let (final_deblurred, final_renders) = (to_final(deblurred), to_final(renders));
            let images = RoundImages {
                enhanced,
                deblurred,
                renders,
                final_enhanced,
                final_deblurred: &final_deblurred,
                final_renders: &final_renders,
            };
            let metrics = job.measure(round, views, &images, next, scene);
            if !metrics.worse_than_previous {
                job.restored(views, &final_renders)?;
            }
            job.brighten_scene(round, next.to_final.as_ref(), scene)?;
            Ok(metrics)
        })?;
        let metrics = RoundMetrics {
            seconds: self.round_seconds,
            ..metrics
        };
        self.rounds.push(metrics.clone());
        self.write_report()?;
        self.sink.event(&Event::RoundFinished {
            metrics: Box::new(metrics),
        });
        Ok(())
    }

    /// The round's scene at the target brightness: what is delivered should no later round be
    /// better. The last round is at that brightness itself, and leaves no file of an earlier plan
    /// behind.
    fn brighten_scene(
        &self,
        round: u32,
        tone: Option<&Tone>,
        scene: &Scene,
    ) -> Result<(), PipelineError> {
        let path = self.workspace.round(round).join(BRIGHTENED);
        let Some(tone) = tone else {
            return self.workspace.remove(&path);
        };
        let mut gaussians = scene.gaussians.clone();
        let curve = tone.scene();
        gaussians.map_colours(|rgb| curve.apply_colour(rgb), |rgb| curve.slope(rgb));
        Ok(ply::write(&gaussians, &path)?)
    }

    /// The scene's renders at the views' cameras and the target brightness: of the best round so
    /// far.
    fn restored(&self, views: &[View], renders: &[Image]) -> Result<(), PipelineError> {
        let folder = self.workspace.path("restored");
        views.iter().zip(renders).try_for_each(|(view, image)| {
            self.picture(
                &folder.join(format!("{}.png", view.name)),
                image,
                EncodeFormat::Png,
            )
        })
    }

    fn measure(
        &self,
        round: u32,
        views: &[View],
        images: &RoundImages<'_>,
        next: &Next,
        scene: &Scene,
    ) -> RoundMetrics {
        let records = evaluate::records(views, images);
        let noise_sigma = evaluate::means(images, metrics::noise_sigma);
        let sigma = noise_sigma.get("enhanced").copied().unwrap_or_default();
        let response = self.response(views, next.target);
        let score = score::score(
            views,
            images.final_renders,
            images.final_enhanced,
            &response,
        );
        let before = self.rounds.last().and_then(|previous| previous.score);
        RoundMetrics {
            round,
            seconds: 0.0,
            gaussians: scene.gaussians.len() as u64,
            steps: scene.training.steps,
            steps_per_second: scene.training.steps_per_second,
            sharpness: evaluate::means(images, metrics::sharpness),
            mean_brightness: evaluate::mean(images.enhanced, metrics::mean_v),
            clipped: evaluate::mean(images.enhanced, metrics::clipped_share),
            noise_ceiling_db: metrics::noise_ceiling(sigma),
            noise_sigma,
            records,
            noise_map: scene.training.noise,
            shake_px: scene.training.shake_px,
            pose_correction_px: scene.training.pose_correction_px,
            non_finite_gradients: scene.training.non_finite_gradients,
            anchor: [next.anchor.alpha, next.anchor.gamma],
            matched: next
                .matched
                .iter()
                .map(|anchor| [anchor.alpha, anchor.gamma])
                .collect(),
            score: Some(score),
            worse_than_previous: before.is_some_and(|before| score < before - 0.01),
        }
    }
}
