//! H_i: the dark views, brightened by the round's tone curve or, as a baseline, once by a network.

use std::sync::Arc;

use super::config::{Options, OptionsError};
use super::context::Context;
use super::dependencies::{Levels, RunDependencies};
use super::error::PipelineError;
use super::restore::Restoration;
use super::round::Round;
use super::tone::{self, Tone};
use super::tools::Tools;
use super::views::{self, View, dark};
use crate::enhance::{self, Anchor, Histogram};
use crate::event::Stage;
use crate::image::Image;
use crate::run_folder::{KeptImages, RoundPictures};

/// The images of all views at one brightness; shared, because H_N and H_{i+1} are used twice.
pub type Brightened = Arc<[Image]>;

/// The brightening of every round.
#[derive(Clone, Debug)]
pub struct Brightening {
    /// P_1..P_N with their curves.
    pub rounds: Vec<Round>,
    /// H_N.
    pub target: Brightened,
    /// Whether a network brightened the views, for every round alike.
    by_network: bool,
}

impl Brightening {
    /// The last round, whose brightness is the target's.
    pub fn last(&self) -> &Round {
        self.rounds.last().expect("options ask for a round or more")
    }

    /// The round after this one.
    pub fn after(&self, round: &Round) -> Option<&Round> {
        self.rounds.get(round.number as usize)
    }

    /// E(L; P), always from the original dark views, so that errors do not accumulate.
    pub fn brighten(&self, round: &Round, views: &[View]) -> Brightened {
        if self.by_network || self.after(round).is_none() {
            return Arc::clone(&self.target);
        }
        round.tone.apply(dark(views)).into()
    }
}

/// Plans P_1..P_N. A network brightens here, and every round then has the nearest curve, for all
/// that needs a curve (light for the shake, colours of the scene).
///
/// # Errors
/// [`PipelineError::Options`] for an invalid target; those of the network.
pub fn plan(
    context: &mut Context<'_>,
    views: &[View],
    dependencies: &RunDependencies,
    tools: &mut Tools<'_>,
) -> Result<Brightening, PipelineError> {
    let options = dependencies.enhance().options();
    let dark = dark(views);
    let counted = views::counted_dark(views);
    let counted: Vec<&Image> = counted.iter().map(|image| &**image).collect();
    let by_network = by_network(context, views, dependencies, tools)?;
    let anchors = match &by_network {
        Some(images) => {
            vec![nearest(context, options, &dark, images); options.round_count() as usize]
        }
        None => {
            let target = target(options, &counted)?;
            context.sink.log(format!("target brightness: {target}"));
            match dependencies.levels() {
                Levels::Rising => enhance::anchors(options.round_count(), target),
                Levels::Target => vec![target; options.round_count() as usize],
            }
        }
    };
    let round = |(number, anchor)| {
        let tone = Tone::fit(options.lut_scope, &counted, &[anchor]);
        Round::new(number, anchor, tone)
    };
    let rounds: Vec<Round> = (1..).zip(anchors).map(round).collect();
    let last = rounds.last().expect("options ask for a round or more");
    let is_by_network = by_network.is_some();
    let target = by_network.unwrap_or_else(|| last.tone.apply(dark));
    Ok(Brightening { rounds, target: target.into(), by_network: is_by_network })
}

/// P_N: the option `target` resolved for these dark views.
///
/// # Errors
/// [`OptionsError`] when it names no brightness.
pub fn target(options: &Options, dark: &[&Image]) -> Result<Anchor, OptionsError> {
    let pooled = Histogram::pooled(dark.iter().copied());
    enhance::resolve_target(&options.target, &pooled)
        .map_err(|error| OptionsError { key: "target".to_owned(), message: error.to_string() })
}

/// Every dark view through the enhancing network, if there is one: a stage before the rounds.
fn by_network(
    context: &mut Context<'_>,
    views: &[View],
    dependencies: &RunDependencies,
    tools: &mut Tools<'_>,
) -> Result<Option<Vec<Image>>, PipelineError> {
    let Some(network) = tools.enhancer.as_deref_mut() else {
        return Ok(None);
    };
    let dark: Vec<Image> = views.iter().map(|view| view.dark.clone()).collect();
    let restoration = Restoration {
        stage: Stage::Enhance,
        round: 0,
        kept: KeptImages::Brightened,
        views,
        images: &dark,
        guides: None,
    };
    restoration.by(network, context, dependencies.enhance()).map(Some)
}

/// The curve nearest to a network's result for the dark views.
fn nearest(
    context: &mut Context<'_>,
    options: &Options,
    dark: &[&Image],
    images: &[Image],
) -> Anchor {
    let fitted = tone::search(options.lut_scope, Anchor::exposure(0.0), options.seed, dark, images);
    let anchor = Anchor::mean(&fitted);
    context.sink.log(format!("the exposure nearest to the network's brightening: {anchor}"));
    anchor
}

/// Runs the stage: H_i and its pictures. `brightened` is H_i if the previous round already made it.
///
/// # Errors
/// [`PipelineError::Io`], [`PipelineError::Cancelled`].
pub fn enhance(
    context: &mut Context<'_>,
    round: &Round,
    views: &[View],
    brightening: &Brightening,
    brightened: Option<Brightened>,
) -> Result<Brightened, PipelineError> {
    context.stage(Stage::Enhance, round.number, |context| {
        let enhanced = brightened.unwrap_or_else(|| brightening.brighten(round, views));
        let kind = RoundPictures::Enhanced;
        views::previews(context.workspace, round.number, kind, views, &enhanced)?;
        Ok(enhanced)
    })
}
