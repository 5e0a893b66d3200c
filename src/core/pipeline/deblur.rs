//! D_i: every enhanced view, deblurred by the network and guided by HR from round 2 on.

use super::context::Context;
use super::dependencies::Dependencies;
use super::error::PipelineError;
use super::restore::Restoration;
use super::round::Round;
use super::views::{self, View};
use crate::deblur::Restorer;
use crate::event::Stage;
use crate::image::Image;
use crate::run_folder::{KeptImages, RoundPictures};

/// The input of a round's deblurring.
#[derive(Clone, Copy, Debug)]
pub struct Blurred<'a> {
    /// The views, for names and sizes.
    pub views: &'a [View],
    /// H_i.
    pub enhanced: &'a [Image],
    /// HR of the previous round, where views are guided.
    pub guides: Option<&'a [Image]>,
}

/// Runs the stage: D_i, made once, and its pictures.
///
/// # Errors
/// [`PipelineError::Deblur`], [`PipelineError::Io`], [`PipelineError::Cancelled`].
pub fn deblur(
    context: &mut Context<'_>,
    network: &mut dyn Restorer,
    round: &Round,
    blurred: Blurred<'_>,
    depends_on: &Dependencies,
) -> Result<Vec<Image>, PipelineError> {
    let restoration = Restoration {
        stage: Stage::Deblur,
        round: round.number,
        kept: KeptImages::Deblurred,
        views: blurred.views,
        images: blurred.enhanced,
        guides: blurred.guides,
    };
    let deblurred = restoration.by(network, context, depends_on)?;
    let (views, kind) = (blurred.views, RoundPictures::Deblurred);
    views::previews(context.workspace, round.number, kind, views, &deblurred)?;
    Ok(deblurred)
}
