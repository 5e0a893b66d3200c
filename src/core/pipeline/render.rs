//! R_i: the scene at every view's camera.

use crate::device::Device;

use super::context::{Advance, Context};
use super::error::PipelineError;
use super::round::Round;
use super::views::{self, View};
use crate::event::Stage;
use crate::gaussians::Gaussians;
use crate::image::Image;
use crate::render::Renderer;
use crate::run_folder::RoundPictures;

/// Runs the stage: R_i and its pictures.
///
/// # Errors
/// [`PipelineError::Render`], [`PipelineError::Io`], [`PipelineError::Cancelled`].
pub fn render(
    context: &mut Context<'_>,
    device: &Device,
    round: &Round,
    views: &[View],
    scene: &Gaussians,
) -> Result<Vec<Image>, PipelineError> {
    let number = round.number;
    context.stage(Stage::Render, number, |context| {
        let renderer = Renderer::new(device);
        let uploaded = renderer.upload(scene)?;
        let mut renders = Vec::with_capacity(views.len());
        for (index, view) in views.iter().enumerate() {
            context.cancel.check()?;
            let render = renderer.render_scene(&uploaded, &view.camera)?;
            renders.push(render.map(|value| value.clamp(0.0, 1.0)));
            let progress = Advance::views(index + 1, views.len());
            context.advance(Stage::Render, number, progress);
        }
        let kind = RoundPictures::Renders;
        views::previews(context.workspace, number, kind, views, &renders)?;
        Ok(renders)
    })
}
