//! P_R: the curves from a round's brightness to that of the next round and of the target.

use super::context::Context;
use super::dependencies::Dependencies;
use super::enhance::{Brightened, Brightening};
use super::error::PipelineError;
use super::round::Round;
use super::tone::{self, Tone};
use super::views::View;
use crate::enhance::Anchor;
use crate::event::Stage;
use crate::image::Image;

/// The results that a round hands to the next.
#[derive(Clone, Debug)]
pub struct Next {
    /// H_{i+1}.
    pub enhanced: Brightened,
    /// From this round's brightness to the next one's.
    pub to_next: Tone,
    /// From this round's brightness to the target's.
    pub to_target: Tone,
    /// The fitted anchors of `to_next`.
    pub matched: Vec<Anchor>,
}

/// Runs the stage; `None` after the last round.
///
/// # Errors
/// [`PipelineError::Cancelled`].
pub fn match_brightness(
    context: &mut Context<'_>,
    round: &Round,
    renders: &[Image],
    views: &[View],
    brightening: &Brightening,
    depends_on: &Dependencies,
) -> Result<Option<Next>, PipelineError> {
    let Some(following) = brightening.after(round) else {
        return Ok(None);
    };
    context.stage(Stage::Match, round.number, |_| {
        let options = depends_on.options();
        let (scope, seed) = (options.lut_scope, options.seed);
        let renders: Vec<&Image> = renders.iter().collect();
        let towards = |wanted: &[Image]| tone::search(scope, round.anchor, seed, &renders, wanted);
        let enhanced = brightening.brighten(following, views);
        let matched = towards(&enhanced);
        let to_next = Tone::fit(scope, &renders, &matched);
        let to_target = match brightening.after(following) {
            None => to_next.clone(),
            Some(_) => Tone::fit(scope, &renders, &towards(&brightening.target)),
        };
        Ok(Some(Next { enhanced, to_next, to_target, matched }))
    })
}
