//! H_i: the dark views, brightened by the round's tone curve or, as a baseline, once by a network.

use super::config::OptionsError;
use super::error::PipelineError;
use super::job::Job;
use super::tone::Tone;
use super::views::View;
use crate::enhance::{self, Anchor};
use crate::event::Stage;
use crate::image::Image;
use crate::reconstruct::Response;

impl Job<'_, '_> {
    /// P_1..P_N. Where a network brightens, it does so here, and every round has the curve that
    /// comes nearest to it: what needs a curve (light for the shake, colours of the scene) uses
    /// that one.
    pub fn anchors(&mut self, views: &[View]) -> Result<Vec<Anchor>, PipelineError> {
        if let Some(images) = self.brightened_by_network(views)? {
            let dark = dark(views);
            let fitted = self.fit(&dark, &images);
            let mean =
                |of: fn(&Anchor) -> f64| fitted.iter().map(of).sum::<f64>() / fitted.len() as f64;
            let anchor = Anchor {
                alpha: mean(|a| a.alpha),
                gamma: mean(|a| a.gamma),
            };
            self.sink.log(format!(
                "the curve nearest to the network's brightening: alpha {:.3}, gamma {:.3}",
                anchor.alpha, anchor.gamma
            ));
            self.brightened = Some(images);
            return Ok(vec![anchor; self.options.rounds as usize]);
        }
        let pooled = enhance::Histogram::pooled(views.iter().map(|view| &view.dark));
        let target =
            enhance::resolve_target(&self.options.target, &pooled).map_err(|e| OptionsError {
                key: "target".to_owned(),
                message: e.to_string(),
            })?;
        self.sink.log(format!(
            "target brightness: alpha {:.3}, gamma {:.3}",
            target.alpha, target.gamma
        ));
        Ok(enhance::anchors(self.options.rounds, target))
    }

    /// Every dark view through the enhancing network, if there is one: a stage before the rounds.
    fn brightened_by_network(
        &mut self,
        views: &[View],
    ) -> Result<Option<Vec<Image>>, PipelineError> {
        if self.tools.enhancer.is_none() {
            return Ok(None);
        }
        let images = self.each_view(Stage::Enhance, 0, "brightened", views, |job, i| {
            let enhancer = job
                .tools
                .enhancer
                .as_deref_mut()
                .expect("looked for above; nothing takes it away");
            Ok((
                enhancer.deblur(&views[i].dark, None)?,
                enhancer.take_warnings(),
            ))
        })?;
        Ok(Some(images))
    }

    /// E(L; P) of every view, without a stage of its own; the network's views where one brightens.
    pub fn enhanced(&self, views: &[View], anchor: Anchor) -> Vec<Image> {
        if let Some(images) = &self.brightened {
            return images.clone();
        }
        let dark = dark(views);
        Tone::fit(self.options.lut_scope, &dark, &[anchor]).apply(&dark)
    }

    /// How light becomes the values of H_i: the camera's sRGB, then the round's curve.
    pub fn response(&self, views: &[View], anchor: Anchor) -> Response {
        let tone = Tone::fit(self.options.lut_scope, &dark(views), &[anchor]);
        Response::through(|v| tone.scene().apply_colour([v; 3])[0])
    }

    /// H_i = E(L; P_i), always from the original dark views.
    pub fn enhance(
        &mut self,
        round: u32,
        views: &[View],
        anchor: Anchor,
    ) -> Result<Vec<Image>, PipelineError> {
        self.round_seconds = 0.0;
        self.stage(Stage::Enhance, round, |job| {
            let enhanced = job.enhanced(views, anchor);
            job.previews(round, "enhanced", views, &enhanced)?;
            Ok(enhanced)
        })
    }
}

fn dark(views: &[View]) -> Vec<Image> {
    views.iter().map(|view| view.dark.clone()).collect()
}
